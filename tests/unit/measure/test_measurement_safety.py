"""A measurement passes no limit, leaves no setpoint astray, hands out no partial matrix."""

import json

import numpy as np
import pytest
from measured_ring import CHANNELS, NOISY, RING, Bench
from numpy.testing import assert_array_equal

from orbitfb.core.errors import (
    AwayError,
    ConfigError,
    MachineError,
    MeasurementError,
    RingError,
    StoppedError,
    WriteError,
)
from orbitfb.measure.column import Table
from orbitfb.measure.journal import Journal
from orbitfb.measure.judging import Judgement
from orbitfb.measure.response_file import nominal_response, read_response, write_response
from orbitfb.policies.masking import MaskSettings
from orbitfb.safety.bounds import Bounds
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

CONDITIONS = {"at_once": False}


def lose_beam(bench):
    bench.machine.current = 0.0


def ask_to_stop(bench):
    bench.stop = True


def fail_reads(bench):
    bench.machine.fail_next_reads(30)


def fail_writes(bench):
    bench.machine.fail_next_writes(3)


def kick(bench):
    bench.machine.plant.kick(500e-6)


def lose_bpms(bench):
    bench.machine.mask(*range(20))


def freeze(bench):
    bench.machine.freeze()


def break_program(bench):
    raise RuntimeError("a fault of the program itself")


@pytest.mark.parametrize("at_once", [1, 0])
@pytest.mark.parametrize(
    "event",
    [ask_to_stop, lose_beam, fail_reads, fail_writes, kick, lose_bpms, freeze, break_program],
)
def test_an_aborted_matrix_measurement_leaves_no_trace(tmp_path, event, at_once):
    bench = Bench(tmp_path, NOISY, interlocks=InterlockSettings())
    moved = []

    def happen(machine):
        moved.append(np.flatnonzero(machine.setpoints() != bench.base))
        event(bench)

    bench.machine.at = {85: happen}
    with pytest.raises((MeasurementError, MachineError, RuntimeError)):
        bench.run(at_once=at_once, rejected_most=5)
    assert moved[0].size  # it happened in the middle
    assert_array_equal(bench.machine.setpoints(), bench.base)
    assert {file.name for file in tmp_path.rglob("*") if file.is_file()} <= {"columns.safetensors"}


@pytest.mark.parametrize("at_once", [1, 0])
def test_no_write_moves_others_or_goes_beyond_a_limit(tmp_path, at_once):
    limits = LimitSettings(setpoint=0.6, change_per_tick=0.07)
    small = {"orbit_rms": 50e-6} if at_once == 1 else {"orbit_rms": 20e-6}
    bench = Bench(tmp_path, limits=limits)
    bench.run(at_once=at_once, **small)
    writes = np.array(bench.machine.writes)
    assert np.abs(writes).max() <= 0.6
    assert np.abs(np.diff(writes, axis=0)).max() <= 0.07 + 1e-12
    moved = np.flatnonzero(np.any(writes != bench.base, axis=0))
    assert_array_equal(moved, bench.correctors)


def test_one_by_one_never_moves_two(tmp_path):
    bench = Bench(tmp_path)
    bench.run()
    assert ((np.array(bench.machine.writes) != bench.base).sum(axis=1) <= 1).all()


@pytest.mark.parametrize("at_once", [1, 0])
def test_it_tells_beforehand_how_many_orbits_it_takes(tmp_path, at_once):
    bench = Bench(tmp_path)
    before = bench.machine.plant.tick
    bench.run(at_once=at_once)
    assert bench.planned == pytest.approx(bench.machine.plant.tick - before, rel=0.03)


def test_what_does_not_fit_the_limits_is_refused_before_anything_moves(tmp_path):
    bench = Bench(tmp_path)
    for settings, told in (
        ({}, "no room"),
        ({"orbit_rms": 200e-6}, "excursion_rms"),
        ({"at_once": 0, "lowest": 0.4, "highest": 0.3}, "not below"),
    ):
        bench.limits = LimitSettings(setpoint=0.24 if not settings else 5.0)
        with pytest.raises(ConfigError, match=told):
            bench.run(**settings)
    bench.limits = LimitSettings(change_per_tick=0.01)
    with pytest.raises(ConfigError, match="change_per_tick"):
        bench.run(at_once=0)
    assert len(bench.machine.writes) == 1


@pytest.mark.parametrize("when", [5, 80])
def test_it_gives_up_when_somebody_else_moves_setpoints(tmp_path, when):
    bench = Bench(tmp_path)
    theirs = 0.01 * (np.arange(180) == 77)
    bench.machine.at = {
        when: lambda machine: machine.write(machine.setpoints() + theirs),
    }
    with pytest.raises(MeasurementError, match=r"somebody else moves them") as caught:
        bench.run()
    assert CHANNELS.setpoint_pvs[77] in str(caught.value)
    mine = list(bench.correctors)
    assert_array_equal(bench.machine.setpoints()[mine], bench.base[mine])


def test_it_goes_on_where_it_was_stopped(tmp_path):
    bench = Bench(tmp_path, NOISY)
    bench.machine.at = {150: lambda _: ask_to_stop(bench)}
    with pytest.raises(StoppedError):
        bench.run()
    kept = bench.journal.load(CONDITIONS, 0.0)
    done = int(kept.measured.sum())
    assert 0 < done < len(bench.correctors)
    bench.stop = False
    before = len(bench.machine.writes)
    result = bench.run(kept)
    moved = np.any(np.array(bench.machine.writes[before:]) != bench.base, axis=0)
    assert_array_equal(np.flatnonzero(moved), bench.correctors[done:])
    assert_array_equal(np.flatnonzero(result.table.measured), bench.correctors)


def test_where_correctors_were_is_on_disk_before_they_move(tmp_path):
    bench = Bench(tmp_path)
    seen = []

    def look(machine):
        moved = bench.journal.moved()
        now = machine.setpoints()
        away = set(np.flatnonzero(now != bench.base))
        known = {CHANNELS.setpoint_pvs.index(name) for name in moved.setpoint_pvs} if moved else {}
        assert away <= set(known)
        for name, value in zip(moved.setpoint_pvs, moved.setpoints, strict=True) if moved else ():
            assert value == bench.base[CHANNELS.setpoint_pvs.index(name)]
        seen.append(len(away))

    bench.machine.at = dict.fromkeys(range(3, 200), look)
    bench.run()
    assert sum(seen) > 50
    assert bench.journal.moved() is None


def test_what_cannot_be_put_back_is_said_and_stays_on_disk(tmp_path):
    bench = Bench(tmp_path)

    def go_away(machine):
        machine.fail_next_writes(10_000)
        ask_to_stop(bench)

    bench.machine.at = {60: go_away}
    with pytest.raises(MeasurementError, match="NOT be put back") as caught:
        bench.run()
    name = CHANNELS.setpoint_pvs[bench.correctors[1]]
    assert name in str(caught.value)
    assert bench.journal.moved().setpoint_pvs == (name,)


@pytest.mark.parametrize("how", ["away", "refuses", "beyond its drive limits"])
def test_one_that_cannot_be_put_back_keeps_none_of_the_others(tmp_path, how, monkeypatch):
    bench = Bench(tmp_path)
    lost = np.zeros(180, dtype=bool)
    lost[40] = True
    setpoints, write = bench.machine.setpoints, bench.machine.write
    bounds = Bounds.of(17.5, 180)

    def asked():
        raise AwayError("CH is away", setpoints(), lost)

    def refused(values, which=None):
        if which is None or which[40]:
            raise WriteError("CH is read-only; nothing was sent")
        return write(values, which)

    def lose(_):
        ask_to_stop(bench)
        if how == "away":
            monkeypatch.setattr(bench.machine, "setpoints", asked)
        if how != "beyond its drive limits":
            monkeypatch.setattr(bench.machine, "write", refused)
            return
        bounds.high[40], bounds.drive[40] = bench.base[40] - 1.0, True

    bench.machine.at = {200: lose}
    with pytest.raises(MeasurementError, match="1 setpoints could NOT be put back") as caught:
        bench.run(at_once=0, bounds=bounds)
    assert CHANNELS.setpoint_pvs[40] in str(caught.value)
    assert CHANNELS.setpoint_pvs[41] not in str(caught.value)
    others = ~lost
    assert_array_equal(setpoints()[others], bench.base[others])
    assert setpoints()[40] != bench.base[40]
    assert len(bench.journal.moved().setpoint_pvs) == 5


def test_columns_of_another_measurement_are_not_taken_up(tmp_path):
    bench = Bench(tmp_path)
    bench.run()
    journal = bench.journal
    assert journal.load(CONDITIONS, 0.0).measured.sum() == 5
    for other, conditions, oldest, told in (
        (Journal(journal.directory, CHANNELS, "elsewhere"), CONDITIONS, 0.0, "differs in ring"),
        (journal, {"at_once": True}, 0.0, "differs in at_once"),
        (journal, CONDITIONS, 2e9, "too old"),
    ):
        with pytest.raises(MeasurementError, match=told):
            other.load(conditions, oldest)
    file = journal.directory / "columns.safetensors"
    for content in (b"", file.read_bytes()[:500], b"x" * 1000, b"\xff" * 8):
        file.write_bytes(content)
        with pytest.raises(MeasurementError, match="--fresh"):
            journal.load(CONDITIONS, 0.0)
    for text in ("", "[]", '{"where": 1}', json.dumps({"where": "here", "time": 0})):
        (journal.directory / "moved.json").write_text(text)
        with pytest.raises(MeasurementError, match="damaged"):
            journal.moved()


FINE = Judgement({}, {}, ())


@pytest.fixture
def whole(tmp_path):
    """A matrix of all correctors, as if measured, and its file."""
    table = Table.empty(180, 180)
    for name, array in table.tensors().items():
        array[:] = 1e-4 if name in ("response", "sigma") else 0.0
    table.response[:] += np.random.default_rng(0).normal(0, 1e-5, (180, 180))
    return table, tmp_path / "response.safetensors"


def test_a_whole_matrix_is_adopted_as_it_is(whole):
    table, file = whole
    write_response(file, table, np.zeros(180), CHANNELS, FINE, {"created": 1.0})
    assert_array_equal(nominal_response(RING, "x", file, MaskSettings()), table.response)
    assert read_response(file, CHANNELS).card["created"] == 1.0


def test_a_partial_or_flagged_matrix_is_never_adopted(whole):
    table, file = whole
    missing, dead, blind = CHANNELS.correctors[5], CHANNELS.correctors[9], CHANNELS.bpms[7]
    for array in table.tensors().values():
        array[..., 5] = np.nan
    judgement = Judgement({dead: "is dead"}, {blind: "is dead"}, (missing,))
    write_response(file, table, np.zeros(180), CHANNELS, judgement, {})
    masks = {"correctors": (missing, dead), "bpms": (blind,)}
    for left_out, name in (("correctors", missing), ("correctors", dead), ("bpms", blind)):
        fewer = {**masks, left_out: tuple(each for each in masks[left_out] if each != name)}
        with pytest.raises(RingError, match=f"not adopted(.|\n)*{name}"):
            nominal_response(RING, "x", file, MaskSettings(**fewer))
    matrix = nominal_response(RING, "x", file, MaskSettings(**masks))
    assert not matrix[:, [5, 9]].any() and not matrix[7].any()
    free = np.setdiff1d(np.arange(180), [5, 9])
    assert_array_equal(np.delete(matrix, 7, 0)[:, free], np.delete(table.response, 7, 0)[:, free])


def test_a_file_that_is_wrong_is_refused(whole, tmp_path):
    table, file = whole
    write_response(file, table, np.zeros(180), CHANNELS, FINE, {})
    with pytest.raises(RingError, match="other planes"):
        read_response(file, RING.channels("y"))
    content = file.read_bytes()
    for wrong in (b"", content[:100], content[:-5], b"\xff" * 50, content + b"x"):
        file.write_bytes(wrong)
        with pytest.raises(RingError, match=r"response\.safetensors"):
            read_response(file, CHANNELS)
    with pytest.raises(RingError, match="cannot be read"):
        nominal_response(RING, "x", tmp_path / "none", MaskSettings())
