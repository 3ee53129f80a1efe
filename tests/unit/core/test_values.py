"""Values made anew from those before, and the median of a few numbers."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from orbitfb.core.robust import median
from orbitfb.core.values import replace
from orbitfb.loop.memory import LoopMemory
from orbitfb.safety.answers.owing import Answering


@dataclass(frozen=True)
class Plain:
    one: int
    two: list[int] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Slotted:
    one: int
    two: int = 2


@pytest.mark.parametrize("value", [Plain(1, [2]), Slotted(1)])
def test_only_what_is_told_differs_and_the_old_value_stays(value):
    after = replace(value, one=5)
    assert type(after) is type(value)
    assert (after.one, value.one) == (5, 1)
    assert after.two is value.two


@pytest.mark.parametrize("value", [Plain(1), Slotted(1)])
def test_a_field_that_is_none_is_refused(value):
    with pytest.raises(TypeError, match="three"):
        replace(value, three=3)


@pytest.mark.parametrize("kind", [LoopMemory, Answering])
def test_what_a_tick_changes_often_is_copied_as_a_whole(kind):
    """With slots each of its fields is copied one by one, at twenty changes a tick."""
    assert not hasattr(kind, "__slots__")
    assert not hasattr(kind, "__post_init__")


@pytest.mark.parametrize("size", [1, 2, 3, 180, 181])
def test_the_median_is_that_of_numpy(size):
    values = np.random.default_rng(size).standard_normal(size)
    assert median(values) == np.median(values)
    values[0] = np.nan
    assert np.isnan(median(values))
