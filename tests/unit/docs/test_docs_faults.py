"""The table of faults names settings and tests that are there."""

import re
from pathlib import Path

import pytest

from orbitfb.config.tree import AppConfig
from orbitfb.core.signals import LoopState
from orbitfb.loop.fault_table.row import Fault
from orbitfb.loop.fault_table.table import FAULTS, faults_markdown

TESTS = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def known() -> set[str]:
    files = TESTS.rglob("test_*.py")
    return {name for file in files for name in re.findall(r"def (test_\w+)", file.read_text())}


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.event[:30])
def test_every_fault_has_its_tests_and_settings(fault: Fault, known: set[str]):
    assert fault.tests and set(fault.tests) <= known, set(fault.tests) - known
    for key in fault.settings:
        section, name = key.split(".")
        part = AppConfig.model_fields[section].annotation
        assert part is not None and name in part.model_fields, key


def test_every_state_that_stops_the_loop_is_in_the_table():
    states = {state for fault in FAULTS for state in fault.states}
    assert {LoopState.HELD, LoopState.TRIPPED, LoopState.FAULT} <= states
    assert faults_markdown().count("\n") == len(FAULTS) + 2
