"""Readings that were not read: drawn so that they are like the others."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.signals import Mask
from orbitfb.diagnose.likelihood.corrected import drawn_apart
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.screen.missing import drawn
from orbitfb.diagnose.screen.repeats import unread
from orbitfb.diagnose.screen.run import screen
from orbitfb.diagnose.screen.spikes import without_spikes
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.diagnose.verdict.proved import proved
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import kinds_for, make_record


def polled(record: Record, share: float, whole: bool) -> Record:
    """What a client gets that asks more often than there are readings."""
    rng = np.random.default_rng(3)
    readings = record.readings.copy()
    for row in range(1, len(readings)):
        same = rng.random(1 if whole else readings.shape[1]) < share
        readings[row] = np.where(same, readings[row - 1], readings[row])
    return replace(record, readings=readings)


def left(record: Record) -> np.ndarray:
    return record.readings - record.setpoints @ record.layout.response.T


def cleared(record: Record) -> tuple[Record, Mask]:
    """The record as it is diagnosed, and what of it was not read."""
    record, spikes = without_spikes(record)
    found = proved(record, (*spikes, *screen(record)), frozenset())
    return found.record, found.record.filled


def test_a_drawn_reading_is_like_one_that_was_read() -> None:
    whole = make_record(61, gain=0.0)
    record, missing = cleared(polled(whole, 0.4, whole=False))
    assert 0.35 < missing.mean() < 0.45
    np.testing.assert_array_equal(record.readings[~missing], whole.readings[~missing])
    for apart in (1, 2, 5):
        steps, usual = (left(one)[apart:] - left(one)[:-apart] for one in (record, whole))
        drawn_ones = missing[apart:] & ~missing[:-apart]
        ratio = np.std(steps[drawn_ones]) / np.std(usual[drawn_ones])
        assert 0.9 < ratio < 1.1  # what is most likely would make 0.7 of it
    again = drawn(replace(record, readings=np.where(missing, 0.0, record.readings)))
    np.testing.assert_array_equal(again.readings, record.readings)


def test_what_is_told_of_the_readings_is_in_them() -> None:
    record = make_record(62, gain=0.0)
    missing = np.random.default_rng(4).random(record.readings.shape) < 0.3
    wave = np.where(np.arange(len(record)) % 2, 50e-6, -50e-6)[:, None] * np.ones(missing.shape[1])
    gone = replace(record, readings=np.where(missing, 0.0, record.readings + wave), filled=missing)
    beyond = left(drawn(gone, wave)) - wave
    assert np.abs(np.diff(beyond, axis=0)).max() < 5e-6
    assert np.abs(np.diff(left(drawn(gone)) - wave, axis=0)).max() > 20e-6


def test_what_jumps_is_not_smoothed() -> None:
    """Not even the readings that are missing at that row come before or after the others."""
    record = make_record(62, gain=0.0)
    missing = np.random.default_rng(4).random(record.readings.shape) < 0.3
    missing[398:402, :3] = True
    jump = 50e-6 * (np.arange(len(record)) >= 400)[:, None] * np.ones(missing.shape[1])
    gone = replace(record, readings=np.where(missing, 0.0, record.readings + jump), filled=missing)
    assert np.abs(np.diff(left(drawn(gone)) - jump, axis=0)).max() < 5e-6


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_an_orbit_may_be_anywhere(share: float) -> None:
    """Millimetres from where the model has it, in every stretch, are no jump."""
    record = make_record(62, gain=0.0)
    starts = np.arange(len(record)) % 300 == 0
    missing = np.random.default_rng(4).random(record.readings.shape) < share
    missing[::300, :3] = True
    away = 5e-3 * np.where(np.arange(missing.shape[1]) % 2, 1.0, -1.0)
    gone = replace(record, readings=record.readings + away, filled=missing, starts=starts)
    steps = np.abs(np.diff(left(drawn(gone)), axis=0))[~starts[1:]]
    assert steps.max() < 5e-6


def test_a_healthy_ring_that_is_polled_has_no_cause() -> None:
    for whole in (False, True):
        record, _ = cleared(polled(make_record(63), 0.5, whole))
        kinds = kinds_for(record)
        accepted, _ = tournament(Workspace.of(record, kinds), kinds)
        assert accepted == []


def test_a_frozen_bpm_is_found_among_held_ones() -> None:
    record = polled(make_record(64), 0.3, whole=False)
    readings = record.readings.copy()
    readings[300:, 5] = readings[300, 5]
    checks = {one.check: one.devices for one in screen(replace(record, readings=readings))}
    assert "held-readings" in checks
    assert checks["frozen-bpm"] == ("B5 (x)",)


def test_a_reading_beside_one_that_was_not_read_is_no_spike() -> None:
    """The orbit steps while the reading is held: it looks as if it came back."""
    record = make_record(65, gain=0.0, dither=0.2)
    assert without_spikes(record)[1] == []
    held = polled(record, 0.4, whole=True)
    assert unread(held)[1:].mean() > 0.35
    assert without_spikes(held)[1] == []


def test_a_bpm_that_stays_at_its_extreme_for_good_is_frozen_and_not_clipped() -> None:
    record = make_record(66)
    readings = record.readings.copy()
    row = 200 + int(np.argmax(readings[200:500, 7]))
    readings[row:, 7] = readings[:, 7].max() + 1e-6
    checks = {one.check for one in screen(replace(record, readings=readings))}
    assert "frozen-bpm" in checks
    assert "rail" not in checks


def test_a_cause_in_a_polled_record_is_named_alone() -> None:
    """A first draw has nothing of it, which would be tails of the noise beside it."""
    half = 250

    def stuck(currents: np.ndarray) -> np.ndarray:
        acting = currents.copy()
        acting[half:, 4] = acting[min(half, len(acting) - 1), 4]
        return acting

    record, _ = cleared(
        polled(make_record(67, currents=stuck, dither=0.1, rows=500), 0.3, whole=False)
    )
    kinds = kinds_for(record)
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    assert [(one.kind.id, one.names) for one in accepted] == [("corrector-stuck", ("C4 (x)",))]


def test_stretches_too_short_for_a_walk_to_show_are_filled_in_with_noise_alone() -> None:
    record = make_record(68, gain=0.0)
    starts = np.arange(len(record)) % 6 == 0
    missing = np.random.default_rng(5).random(record.readings.shape) < 0.1
    found = drawn(replace(record, starts=starts, filled=missing))
    assert np.isfinite(found.readings).all()
    steps = np.abs(np.diff(left(found), axis=0))[~starts[1:]]
    assert steps.max() < 10.0 * np.median(steps)


def test_a_reading_that_is_missing_where_a_cause_jumps_is_drawn_elsewhere_with_it() -> None:
    """Without the cause it is as before the jump, with it as after; a smooth course tells nothing.

    A reading that is elsewhere by 40 standard deviations of its noise is so by ½ 40² nats.
    """
    record = make_record(5)
    filled = np.zeros_like(record.readings, dtype=bool)
    filled[400, 3] = True
    space = Workspace.of(replace(record, filled=filled), kinds_for(record))
    rows = np.arange(len(record.readings))
    size = 40.0 * np.sqrt(space.noise.reading[3])
    pattern = np.eye(record.readings.shape[1])[3]
    jump = space.transform.spectrum(np.outer(size * (rows >= 400), pattern))
    slope = space.transform.spectrum(np.outer(size * rows / len(rows), pattern))
    assert drawn_apart(space, jump) == pytest.approx(0.5 * 40.0**2, rel=0.05)
    assert drawn_apart(space, slope) < 1.0
    nothing = replace(space, signals=replace(space.signals, record=record))
    assert drawn_apart(nothing, jump) == 0.0
