"""A BPM that reads its noise while the beam moves is found, with the row; one at rest is not."""

from dataclasses import replace

import numpy as np
import pytest

from orbitfb.core.signals import Vector
from orbitfb.diagnose.screen.deaf import check_deaf
from orbitfb.diagnose.screen.run import screen
from orbitfb.diagnose.verdict.proved import proved
from orbitfb.records.layout import Devices
from orbitfb.records.record import Record
from tests.unit.hypotheses.small_records import NOISE, make_record


def moving(seed: int = 51) -> Record:
    """A loop that is open, so that all BPMs see the beam walk."""
    return make_record(seed, gain=0.0)


def with_readings(record: Record, column: int, row: int, own: Vector) -> Record:
    readings = record.readings.copy()
    readings[row:, column] = own[row:]
    return replace(record, readings=readings)


def noise(record: Record) -> Vector:
    return NOISE * np.random.default_rng(5).standard_normal(len(record))


@pytest.mark.parametrize("row", [0, 200, 437, 600])
@pytest.mark.parametrize("offset", [0.0, 20e-6])
def test_a_bpm_that_reads_its_noise_is_found_with_the_row(row: int, offset: float) -> None:
    record = moving()
    record = with_readings(record, 3, row, offset + noise(record))
    (finding,) = check_deaf(record)
    assert finding.devices == (record.layout.bpms.label(3),)
    assert finding.effect == "bpm-stuck"
    assert finding.rows is not None
    assert abs(finding.rows[0] - row) <= 10  # the beam may pass by what it reads
    found = proved(record, screen(record), frozenset())
    assert [cause.effect for cause in found.causes] == ["bpm-stuck"]
    assert len(found.record.layout.bpms) == len(record.layout.bpms) - 1


def test_healthy_bpms_are_not() -> None:
    assert not check_deaf(moving())
    assert not check_deaf(make_record(52))


def test_a_bpm_where_the_beam_does_not_move_any_more_is_not() -> None:
    """From row 450 on only one pattern moves, and this BPM stands at its node."""
    record = moving()
    layout = record.layout
    setpoints = record.setpoints.copy()
    setpoints[450:] = setpoints[450]
    wave = 1e-4 * np.random.default_rng(6).standard_normal(len(record)).cumsum()
    node = np.linalg.svd(layout.response[3:4])[2][-1]
    readings = setpoints @ layout.response.T
    readings[450:] += np.outer(wave[450:] * 1e3, layout.response @ node)
    readings += NOISE * np.random.default_rng(7).standard_normal(readings.shape)
    still = replace(record, setpoints=setpoints, readings=readings)
    assert np.std(still.readings[450:, 3]) < 1.2 * NOISE
    assert np.median(np.std(still.readings[450:], axis=0)) > 10.0 * NOISE
    assert not check_deaf(still)


def test_one_that_is_reversed_or_frozen_is_not_deaf() -> None:
    record = moving()
    assert not check_deaf(with_readings(record, 3, 450, -record.readings[:, 3]))
    assert not check_deaf(with_readings(record, 3, 450, np.full(len(record), 1e-6)))


def test_a_bpm_that_sees_the_beam_move_little_is_not_deaf() -> None:
    """A twentieth of what the others see of every pattern, hidden in its noise."""
    record = moving()
    own = 0.05 * record.readings[:, 3] + 5.0 * noise(record)
    assert not check_deaf(with_readings(record, 3, 0, own))
    assert check_deaf(with_readings(record, 3, 0, noise(record)))


def test_a_beam_that_moves_in_one_plane_only_makes_no_bpm_of_the_other_deaf() -> None:
    record = moving()
    count = len(record.layout.bpms)
    names = tuple(f"B{i}" for i in range(count))
    both = Devices(names + names, ("x",) * count + ("y",) * count, ("",) * 2 * count)
    still = NOISE * np.random.default_rng(8).standard_normal(record.readings.shape)
    response = np.vstack([record.layout.response, np.zeros_like(record.layout.response)])
    wide = replace(
        record,
        layout=replace(record.layout, bpms=both, response=response),
        readings=np.hstack([record.readings, still]),
        filled=np.zeros((len(record), 2 * count), dtype=np.bool_),
    )
    assert wide.layout.planes == ("x", "y")
    assert not check_deaf(wide)
