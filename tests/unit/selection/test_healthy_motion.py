"""Motion that healthy rings have and not every one: in the floor, and no cause."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from orbitfb.diagnose.hypotheses.candidate import Candidate
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection import rounds
from orbitfb.diagnose.selection.beside import enough_beside
from orbitfb.diagnose.selection.echoes import is_echo
from orbitfb.diagnose.selection.healthy_motion import _GLIMPSE, _TURNS, _floor
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.registry import effect
from orbitfb.estimation.moments import Moments
from orbitfb.estimation.priors import SURE
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import NOISE, ROWS, kinds_for, make_record, recorded


def with_kicks(record: Record, kicks: Matrix) -> Record:
    """The record of a beam that is kicked besides, by amounts of the correctors [A]."""
    return replace(record, readings=record.readings + kicks @ record.layout.response.T)


def named(record: Record) -> list[str]:
    kinds = kinds_for(record)
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    return [one.kind.id for one in accepted]


def shaking(places: int) -> Record:
    """A healthy ring some places of which shake faster than it is read."""
    rng = np.random.default_rng(5)
    record = make_record(51, gain=0.0)
    kicks = np.zeros_like(record.setpoints)
    kicks[:, :places] = 0.05 * rng.standard_normal((ROWS, places))
    return with_kicks(record, kicks)


def drifting() -> Record:
    """A healthy ring whose ground drifts smoothly, with a spectrum f^−4."""
    rng = np.random.default_rng(6)
    record = make_record(52, gain=0.0, dither=0.005)
    frequency = np.fft.rfftfreq(4 * ROWS)
    frequency[0] = np.inf
    drawn = np.fft.rfft(rng.standard_normal((4 * ROWS, record.setpoints.shape[1])), axis=0)
    smooth = np.fft.irfft(drawn * frequency[:, None] ** -2.0, axis=0)[:ROWS]
    return with_kicks(record, 0.3 * (smooth - smooth[0]) / smooth.std())


def going_on() -> Record:
    """A healthy ring in feedback whose ground goes on in the direction of before."""
    rng = np.random.default_rng(9)
    layout = make_record(53).layout
    response, inverse = layout.response, np.linalg.pinv(layout.response)
    drawn = 5e-2 * rng.standard_normal((ROWS, response.shape[1]))
    ground = lfilter([1.0], [1.0, -0.5], drawn, axis=0).cumsum(axis=0) @ response.T
    noise = NOISE * rng.standard_normal(ground.shape)
    setpoints, readings = np.zeros_like(drawn), np.zeros_like(ground)
    for row in range(ROWS):
        readings[row] = ground[row] + response @ setpoints[row] + noise[row]
        if row + 1 < ROWS:
            setpoints[row + 1] = setpoints[row] - 0.4 * inverse @ readings[row]
    return recorded(layout, setpoints, readings)


@pytest.mark.parametrize("places", [pytest.param(1, marks=pytest.mark.nightly), 4])
def test_shaking_is_no_cause(places: int, monkeypatch: pytest.MonkeyPatch) -> None:
    record = shaking(places)
    assert named(record) == []
    monkeypatch.setattr(rounds, "with_motion", lambda *given: None)
    assert named(record)  # a floor that has no such motion gives it a name


@pytest.mark.parametrize("record", [drifting(), going_on()], ids=["drifts", "goes on"])
def test_ground_that_does_not_walk_is_no_cause(
    record: Record, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert named(record) == []
    monkeypatch.setattr(rounds, "with_motion", lambda *given: None)
    assert named(record)  # a floor that can only walk gives it a name


@pytest.mark.parametrize("places", [1, 4])
def test_one_turn_shows_enough_of_it(places: int) -> None:
    """Else the other turns would not be taken: `_GLIMPSE`."""
    record = shaking(places)
    space = Workspace.of(record, kinds_for(record))
    left, scatter = space.unmodelled()
    moments = Moments.of(left, space.transform).beside(scatter)
    one, all_of_them = (_floor(space, moments, True, turns) for turns in (1, _TURNS))
    assert moments.more(one, space.noise) > 1.5 * _GLIMPSE * moments.more(all_of_them, space.noise)


def test_a_source_that_switches_is_one() -> None:
    rng = np.random.default_rng(7)
    record = make_record(53, gain=0.0)
    kicks = np.zeros_like(record.setpoints)
    kicks[:, 3] = 0.1 * np.cumprod(np.where(rng.random(ROWS) < 0.02, -1.0, 1.0))
    assert named(with_kicks(record, kicks)) == ["telegraph"]


def test_what_healthy_errors_leave_is_not_told() -> None:
    """They are told to first order, so the bar rises with what they explain, up to their limits."""
    record = make_record(54, gain=0.0)
    rng = np.random.default_rng(8)
    usual = 1.0 + 0.01 * rng.standard_normal(record.readings.shape[1])
    twice = 1.0 + 0.5 * np.sign(usual - 1.0)
    bars = []
    for gains in (np.ones_like(usual), usual, twice):
        read = replace(record, readings=record.readings * gains)
        bars.append(enough_beside(0.0, Workspace.of(read, [effect("bpm-gain")])))
    assert SURE == bars[0] < bars[1] < bars[2] < SURE + 1.0  # without a limit it is 192 more


def test_errors_follow_the_currents_of_a_cause_that_is_known() -> None:
    """The gain of a corrector that stands still changes nothing: its setpoints act no more."""
    half = ROWS // 2

    def stuck(currents: Matrix) -> Matrix:
        acting = currents.copy()
        acting[half:, 4] = acting[min(half, len(acting) - 1), 4]
        return acting

    record = make_record(55, currents=stuck)
    kinds = [effect("corrector-gain"), effect("corrector-stuck")]
    space = Workspace.of(record, kinds)
    before = space.transform.summed(space.terms.spectrum.astype(float))[:, 4]
    accepted, its = tournament(space, kinds)
    assert [(one.kind.id, one.names) for one in accepted] == [("corrector-stuck", ("C4 (x)",))]
    after = its[-1].space.transform.summed(its[-1].space.terms.spectrum.astype(float))[:, 4]
    assert np.ptp(before[half + 2 :]) > 0.01
    assert np.ptp(after[half + 2 :]) < 1e-6


def test_one_law_of_its_noise_is_enough_for_a_bpm() -> None:
    def noisy(name: str, *places: int) -> Candidate:
        told = tuple(f"B{place} (x)" for place in places)
        return Candidate(effect(name), places, told, {}, 100.0, noisy=True)

    accepted = [noisy("noise-level", 1, 2)]
    assert is_echo(noisy("noise-tails", 2), accepted)
    assert not is_echo(noisy("noise-tails", 3), accepted)


@pytest.mark.nightly
def test_noise_of_the_readings_is_as_it_was() -> None:
    record = shaking(4)
    kinds = kinds_for(record)
    _, its = tournament(Workspace.of(record, kinds), kinds)
    noise = its[-1].space.noise
    assert noise.shaken is not None
    np.testing.assert_allclose(np.sqrt(np.median(noise.reading)), NOISE, rtol=0.1)
