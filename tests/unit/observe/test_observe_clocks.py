"""Somebody sets a clock: it is said, and counted, once for each time."""

from dataclasses import replace

from observe_records import record

from orbitfb.observe.clock_watch import ClockWatch


class Clock:
    def __init__(self) -> None:
        self.time, self.set_by = 5000.0, 2.0e9

    def monotonic(self) -> float:
        return self.time

    def wall(self) -> float:
        return self.time + self.set_by


def test_a_clock_that_was_set_is_told_and_counted():
    clock, told, ioc = Clock(), [], 0.0
    watch = ClockWatch(clock, told.append)

    def tick(late: float = 0.0, orbit: bool = True) -> None:
        clock.time += 0.1
        one = record(0)
        assert one.reading is not None
        seen = replace(one.reading.orbit, time=clock.time + ioc - late)
        reading = replace(one.reading, orbit=seen, received=clock.time)
        watch(replace(one, reading=reading if orbit else None))

    for late in (0.0, 0.9, 0.0, 0.05):
        tick(late)
    assert not told and watch.steps == 0
    clock.set_by += 3600.0
    tick()
    tick()
    assert told == ["somebody set the clock of this computer by +3.6e+03 s"]
    ioc -= 60.0
    tick(orbit=False)
    tick()
    assert told[1] == "somebody set the clock of the machine's stamps by -60 s"
    clock.set_by -= 30.0
    ioc -= 30.0
    tick()
    assert "computer by -30 s and the clock of the machine's" in told[2]
    assert watch.steps == 3
