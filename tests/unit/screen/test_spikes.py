"""Lone spikes are left out and told; noise with tails, steps and motion of the beam stay."""

import numpy as np
import pytest
from scipy.stats import poisson

from orbitfb.diagnose.screen.spikes import LONE, TAILS, most_lone, without_spikes
from tests.unit.hypotheses.small_records import make_record


@pytest.fixture
def record():
    return make_record(41)


@pytest.mark.parametrize("size", [50e-6, 5e-3, 1.0, -1.0])
def test_a_lone_spike_is_left_out_and_told(record, size):
    clean = record.readings.copy()
    record.readings[50, 3] += size
    found, findings = without_spikes(record)
    (finding,) = findings
    assert finding.devices == (record.layout.bpms.label(3),)
    assert finding.rows == (50, 50)
    assert "1 reading of" in finding.text
    assert found.filled[50, 3]
    assert found.filled.sum() == 1
    noise = np.std(np.diff(clean[:, 3]))
    assert abs(found.readings[50, 3] - clean[50, 3]) < 5 * noise
    rest = np.ones(clean.shape, dtype=bool)
    rest[50, 3] = False
    np.testing.assert_array_equal(found.readings[rest], clean[rest])


def test_spikes_at_both_ends_of_a_record_are_left_out(record):
    record.readings[0, 2] += 1e-3
    record.readings[-1, 5] -= 1e-3
    found, _ = without_spikes(record)
    assert np.argwhere(found.filled).tolist() == [[0, 2], [len(record) - 1, 5]]


def test_a_healthy_record_has_none(record):
    found, findings = without_spikes(record)
    assert found is record
    assert not findings


def test_a_step_of_a_bpm_is_no_spike(record):
    record.readings[200:, 3] += 50e-6
    assert not without_spikes(record)[1]


def test_a_motion_that_ends_or_begins_with_the_record_is_no_spike(record):
    fading = 50e-6 * 0.5 ** np.arange(len(record))
    record.readings[:, 2] += fading
    record.readings[:, 5] += fading[::-1]
    assert not without_spikes(record)[1]


def test_what_many_bpms_see_is_motion_of_the_beam(record):
    record.readings[100] += 50e-6
    assert not without_spikes(record)[1]


def test_many_spikes_are_noise_with_tails(record):
    record.readings[20:500:16, 3] += 50e-6
    assert not without_spikes(record)[1]


@pytest.mark.parametrize("rows", [300, 900, 3000])
def test_the_likelier_of_lone_spikes_and_noise_with_tails_is_believed(rows):
    most = most_lone(rows)
    fewer, more = int(most), int(most) + 1
    lone, tails = poisson(LONE * rows), poisson(TAILS * rows)
    assert fewer == 1 or lone.pmf(fewer) > tails.pmf(fewer)
    assert tails.pmf(more) > lone.pmf(more)


def test_two_spikes_of_a_bpm_are_lone_in_a_record_of_some_length(record):
    record.readings[[50, 300], 3] += 50e-6
    assert without_spikes(record)[0].filled[[50, 300], 3].all()
