"""Scenarios for tests of the paper's experiment."""

from dataclasses import replace

from orbitfb.evaluate.paper.scenarios import Scenario, make_scenario


def still(steps: int = 10_000, **changed: object) -> Scenario:
    """Give a ring whose response does not drift and whose orbit does not move by itself."""
    made = make_scenario("s1", steps=steps, after=0)
    fixed = {"end": made.start, "physical": False, "walk": None, "white": 0.0}
    return replace(made, **{**fixed, **changed})
