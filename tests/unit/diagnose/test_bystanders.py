"""Groups of which not all members are struck."""

from dataclasses import replace

import pytest
from test_scans import BPMS, CORRECTORS, record_with

from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.bystanders import with_neighbour, without_idle
from orbitfb.diagnose.candidate import Candidate
from orbitfb.diagnose.explain import Cause
from orbitfb.diagnose.tournament import tournament
from orbitfb.effects.registry import all_effects

CELL = [name for name in CORRECTORS if name.endswith("C09")]


@pytest.mark.parametrize("spared", [[], CELL[3:4], CELL[1:3]])
def test_a_crate_need_not_end_where_its_cell_does(spared):
    struck = [name for name in CELL if name not in spared]
    effect = f"corrector-lag:tau=0.1s,names={'+'.join(struck)}"
    bench = Bench(record_with(effect, dither=2e-3))
    found, *_ = tournament(bench, [all_effects()["corrector-lag"]])
    assert [CORRECTORS[place] for place in found.cause.places] == struck
    without = f" without {', '.join(spared)}" if spared else ""
    assert found.candidate.group == f"C09{without}"
    low, high = found.fit.interval(0)
    assert low < 0.1 < high


def test_a_crate_may_reach_over_the_end_of_a_cell():
    """A tick late at four BPMs, the last two of a cell and the first two of the next."""
    order = [*BPMS]
    first = order.index(next(name for name in order if name.endswith("C10")))
    struck = order[first - 2 : first + 2]
    assert {name[-3:] for name in struck} == {"C09", "C10"}
    bench = Bench(record_with(f"bpm-latency:ticks=1,names={'+'.join(struck)}", dither=1e-4))
    found, *_ = tournament(bench, [all_effects()["bpm-latency"]])
    assert [BPMS[place] for place in found.cause.places] == struck


def test_a_limit_is_of_the_cell_that_reaches_it():
    """Of a run of cells only one has correctors that go faster than the limit."""
    record = record_with("corrector-slew:rate=1A/s", dither=1e-4)
    moved = record.setpoints.copy()
    reach = [column for column, name in enumerate(CORRECTORS) if name in CELL[1:4]]
    moved[300:, reach] += 1e-2
    bench = Bench(replace(record, setpoints=moved))
    run = [c for c, name in enumerate(CORRECTORS) if name[-3:] in ("C07", "C08", "C09", "C10")]
    slew = all_effects()["corrector-slew"]
    candidate = Candidate(Cause(slew, tuple(run), {"rate": 5e-2}), 50.0, 500.0, "C07–C10")
    fewer = without_idle(bench, candidate, candidate.cause)
    assert fewer is not None and fewer.group == "C09"
    assert [CORRECTORS[place] for place in fewer.cause.places] == CELL
    assert without_idle(bench, fewer, fewer.cause) is None
    all_of_them = replace(candidate, cause=replace(candidate.cause, values={"rate": 1e-9}))
    assert without_idle(bench, all_of_them, all_of_them.cause) is None


def test_a_large_constant_current_makes_nobody_idle():
    record = record_with("corrector-gain:gain=-0.2,cells=C09", dither=2e-3)
    moved = record.setpoints.copy()
    moved[:, CORRECTORS.index(CELL[2])] += 100.0
    bench = Bench(replace(record, setpoints=moved))
    own = tuple(CORRECTORS.index(name) for name in CELL)
    cause = Cause(all_effects()["corrector-gain"], own, {"gain": -0.2})
    assert without_idle(bench, Candidate(cause, 100.0, 500.0, "C09"), cause) is None


def test_one_device_stays_one():
    bench = Bench(record_with(f"bpm-gain:gain=-0.2,names={BPMS[40]}", dither=2e-3))
    found, *_ = tournament(bench, [all_effects()["bpm-gain"]])
    assert found.cause.places == (40,)
    assert with_neighbour(bench, found.candidate, found.cause) is None


def test_what_strikes_all_has_no_neighbours():
    bench = Bench(record_with("loop-delay:ticks=0.5", dither=2e-3))
    kind = all_effects()["loop-delay"]
    cause = Cause(kind, (), {"ticks": 0.5})
    assert with_neighbour(bench, Candidate(cause, 10.0, 1.0), cause) is None
