"""The judge of the chaos campaigns finds every broken rule; the schedule is that of its seed."""

import numpy as np
import pytest

from tests.chaos.devices import FaultyRing
from tests.chaos.growth import Life, grown
from tests.chaos.journal import RECORD, Journal, read
from tests.chaos.judge import EXCESS, broken_in, broken_rules, put_figures, trips, wandered
from tests.chaos.kinds import KINDS
from tests.chaos.notes import FORGIVEN, Notes
from tests.chaos.schedule import Episode, Fault, Lived, schedule

SIZE = 4
ALL = np.arange(SIZE)


@pytest.fixture
def noted(tmp_path):
    """Notes of a ring of four correctors, its ticks, and what the judge makes of them."""

    class Noted:
        def __init__(self):
            self.notes = Notes(Journal(tmp_path / "j"), 0, limit=1.0, step=0.2, size=SIZE)
            self.ticks = 0
            for _ in range(10):
                self.tick()

        def tick(self, good=True):
            self.notes.tick(self.ticks, good, np.zeros(SIZE), 0)
            self.ticks += 1

        def put(self, value=0.1, before=0.0):
            self.notes.put(ALL, np.full(SIZE, value), np.full(SIZE, before), drive=1.2)

        def broken(self):
            self.tick()
            return [
                line.split(":")[0] for line in broken_rules(put_figures(read(tmp_path / "j"), 50))
            ]

    return Noted()


def test_one_put_for_each_good_orbit_breaks_nothing(noted):
    for _ in range(20):
        noted.put()
        noted.tick()
    noted.tick(good=False)
    noted.put()  # was under way
    assert noted.broken() == []


def test_what_a_hand_left_beyond_the_limit_may_come_back_and_no_more(noted):
    noted.put(1.05, before=1.15)
    noted.tick()
    noted.put(1.05, before=1.05)
    assert noted.broken() == []
    noted.put(1.06, before=1.05)
    assert noted.broken() == ["puts over the limit"]


def test_over_the_limit_on_the_other_side_is_not_back(noted):
    noted.put(-1.01, before=1.15)
    assert "puts over the limit" in noted.broken()


def test_puts_that_come_late_but_together_break_nothing(noted):
    for _ in range(3):
        noted.tick()
    for _ in range(3):
        noted.put()
    assert noted.broken() == []


def test_an_orbit_that_is_integrated_again_and_again_is_found(noted):
    for _ in range(4):
        noted.put()
        noted.tick(good=False)
    assert noted.broken() == ["writes on an orbit not to act on"]


def test_one_write_long_after_the_last_good_orbit_is_found(noted):
    for _ in range(12):
        noted.tick(good=False)
    noted.put()
    assert noted.broken() == ["writes on an orbit not to act on"]


@pytest.mark.parametrize(
    ("value", "before", "broken"),
    [
        (np.nan, 0.0, ["puts not finite"]),
        (-np.inf, 0.0, ["puts not finite"]),
        (1.1, 1.0, ["puts over the limit"]),
        (-1.3, -1.2, ["puts over the limit", "puts over the drive limit"]),
        (0.5, 0.2, ["steps over the limit"]),
    ],
)
def test_values_are_judged(noted, value, before, broken):
    noted.put(value, before)
    assert noted.broken() == broken


def test_a_hand_at_a_setpoint_is_forgiven_for_a_while(noted):
    for index in ALL:
        noted.notes.moved(index)
    noted.put(0.5)
    assert noted.broken() == []
    for _ in range(FORGIVEN):
        noted.tick()
    noted.put(0.5)
    assert noted.broken() == ["steps over the limit"]


def at(second, **line):
    return {"timestamp": f"2026-01-01T00:00:{second:02d}+00:00", **line}


def test_trips_need_a_reason_and_a_post_mortem():
    log = [at(1, state="TRIPPED", reason="beam"), at(9, state="TRIPPED", reason="")]
    found = trips(log, [at(2)], [])
    assert len(found) == 2 and "no reason" in found[0] and "no post-mortem" in found[1]
    assert trips(log[:1], [at(2)], []) == []
    assert trips(log[:1], [], [(0.0, 2e9)]) == []


def test_growth_is_found():
    life = Life(0, [(float(t), 100.0 + t, 20 + t // 10, 10) for t in range(200)])
    assert [line.split()[0] for line in grown(life.figures(10.0))] == ["memory_mb", "files"]
    flat = Life(0, [(float(t), 100.0, 20, 10) for t in range(200)])
    assert grown(flat.figures(10.0)) == []


def test_a_seed_is_a_schedule():
    first, again, other = (list(schedule(seed, 500)) for seed in (1, 1, 2))
    assert first == again != other
    assert sum(len(episode.faults) for episode in first) == 500
    assert {fault.kind for episode in first for fault in episode.faults} == {k.name for k in KINDS}
    assert {episode.pattern for episode in first} == {"single", "overlapping", "flapping"}


def test_a_schedule_of_some_kinds_has_only_these():
    some = [kind for kind in KINDS if kind.name in ("IOC killed", "disk full")]
    found = list(schedule(3, 40, some))
    assert sum(len(episode.faults) for episode in found) == 40
    assert {fault.kind for each in found for fault in each.faults} == {kind.name for kind in some}
    with pytest.raises(ValueError, match="ends the life"):
        list(schedule(3, 40, [kind for kind in KINDS if kind.early]))


@pytest.mark.parametrize(
    ("told", "good"),
    [
        ({"0": "nan", "1": "zero"}, True),
        ({"178": "nan", "179": "invalid", "0": "gone"}, False),
        (dict.fromkeys(map(str, range(0, 27, 3)), "stamp"), True),
        (dict.fromkeys(map(str, range(0, 30, 3)), "stamp"), False),
        (dict.fromkeys(map(str, range(0, 60, 3)), 1e-3), True),  # the loop has to find out
    ],
)
def test_the_quota_is_counted_here_too(told, good):
    assert faulty_ring()._may_act([{"id": "0", "bpms": told}], 0.0) is good


def faulty_ring():
    class Channels:
        bpms = range(180)

    class Plain:
        channels = Channels

    return FaultyRing(Plain())


def test_the_current_is_judged_as_anybody_can_see_it():
    ring = faulty_ring()
    old, gone, less = ({"id": "0", "current_old": True}, {"id": "1", "current": None}, 250.0)
    ring._began["0"] = 0.0
    assert not ring._may_act([gone], 0.1)
    assert ring._may_act([{"id": "1", "current": less}], 0.1)
    assert ring._may_act([old, gone], 0.1)
    assert not ring._may_act([old, gone], 1.0)


def test_a_torn_record_is_left_out(tmp_path):
    journal = Journal(tmp_path / "j")
    journal.write(tick=3)
    journal.write(tick=4)
    (tmp_path / "j").write_bytes((tmp_path / "j").read_bytes()[:-1])
    assert read(tmp_path / "j")["tick"].tolist() == [3] and RECORD.itemsize < 100


def test_a_beam_that_blind_devices_move_far_is_found():
    rows = np.zeros(10, dtype=RECORD)
    rows["wall"], rows["peak"] = np.arange(10), 30e-6
    rows["peak"][5:] = 90e-6
    assert wandered(rows, [lived(0.0, 4.0), lived(6.0, 9.0)]) == []
    assert "60 um" in wandered(rows, [lived(2.0, 5.0)])[0]
    assert wandered(rows, [lived(2.0, 5.0, blind=False)]) == []
    assert wandered(rows, [lived(4.0, 9.0)]) == []  # a kick before it ended
    assert "episode 7: |orbit| grew by 60 um" in wandered(rows, [lived(2.0, 9.0)])[0]
    soon = [lived(2.0, 4.9), lived(4.95, 5.0, blind=False)]
    assert wandered(rows, soon) == []  # what came next moved it


def lived(begin, end, blind=True, number=7):
    what = {"blind": [0]} if blind else {"slow": 3}
    return Lived(Episode(number, "single", (Fault("", "ring", what, 0.0, 1.0),)), begin, end)


def test_a_broken_rule_is_told_with_its_episode():
    rows = np.zeros(10, dtype=RECORD)
    rows["wall"], rows["tick"], rows["good"] = np.arange(10), np.arange(10), np.arange(10)
    rows["puts"], rows["excess"][[2, 7, 8]] = 1, EXCESS + 1
    times = [lived(0.5, 1.0, number=3), lived(4.0, 5.0, number=4), lived(6.5, 7.0, number=5)]
    assert broken_in(rows, times) == {3: 1, 5: 2}
