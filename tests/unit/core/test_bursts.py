"""What somebody does again and again is told first, then counted."""

from orbitfb.core.bursts import REST, Bursts
from orbitfb.core.clock import ManualClock


def test_the_first_are_told_and_the_others_counted():
    clock = ManualClock()
    bursts = Bursts(clock, quiet_time=10.0, free=2)
    assert [bursts.add("a", str(k)) for k in range(5)] == [1, 1, 0, 0, 0]
    assert bursts.add("b") == 1, "each source for itself"
    assert bursts.due() == []
    clock.advance(10.0)
    assert bursts.due() == [("a", "4", 3)]
    assert bursts.add("a", "5") == 0, "who goes on is counted from the beginning"
    clock.advance(10.0)
    assert bursts.due() == [("a", "5", 1)]


def test_who_was_quiet_is_told_anew():
    clock = ManualClock()
    bursts = Bursts(clock, quiet_time=10.0, free=1)
    assert (bursts.add("a"), bursts.add("a")) == (1, 0)
    for _ in range(2):
        clock.advance(10.0)
        bursts.due()
    assert bursts.add("a") == 1


def test_inventing_names_does_not_help():
    bursts = Bursts(ManualClock(), free=1, most=3)
    assert sum(bursts.add(f"name {k}") for k in range(1000)) == 4
    assert bursts.add(REST) == 0


def test_what_was_counted_elsewhere_counts_as_often():
    clock = ManualClock()
    bursts = Bursts(clock, free=1)
    assert bursts.add("a", times=7) == 7
    bursts.add("a", "x", times=9)
    clock.advance(10.0)
    assert bursts.due() == [("a", "x", 9)]
