"""The judge of the soak finds what grows and what is lost."""

import dataclasses

import pytest

from tests.soak.flat import Soak

WELL = Soak(
    "ring", 1000, 1.0, 60.0, (100.0, 104.0), (20.0, 20.0), (8.0, 8.0), (5.0, 5.1), (2.0, 2.0)
)


def test_a_flat_soak_has_no_problem():
    assert WELL.problems(16.0) == []


@pytest.mark.parametrize(
    ("figure", "value", "word"),
    [
        ("memory_mb", (100.0, 120.0), "memory"),
        ("memory_mb", (100.0, float("nan")), "memory"),
        ("files", (20.0, 23.0), "files"),
        ("threads", (8.0, 10.0), "threads"),
        ("p99_ms", (5.0, 9.0), "p99"),
        ("lost", 1, "1 orbits lost"),
    ],
)
def test_what_grows_or_is_lost_is_a_problem(figure, value, word):
    (problem,) = dataclasses.replace(WELL, **{figure: value}).problems(16.0)
    assert word in problem
