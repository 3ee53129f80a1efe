"""Lines in what is left of a record, and rhythms of how much it scatters."""

import numpy as np
import pytest

from orbitfb.diagnose.gof_lines import line_tests

ROWS, BPMS = 1500, 90
NAMES = tuple(f"B{index}" for index in range(BPMS))
RATE = 0.01 / 15
EVERY = 17.0


@pytest.fixture
def white():
    return np.random.default_rng(3).standard_normal((ROWS, BPMS))


@pytest.fixture
def wave():
    return np.sqrt(2.0) * np.cos(2 * np.pi * np.arange(ROWS) / EVERY)


def flagged(channels):
    return {test.name: test for test in line_tests(channels, NAMES, RATE) if test.flagged}


def test_white_noise_has_no_lines(white):
    assert not flagged(white)
    assert len(line_tests(white, NAMES, RATE)) == 3


def test_a_smooth_spectrum_has_no_lines(white):
    coloured = white.copy()
    for row in range(1, ROWS):
        coloured[row] += 0.3 * coloured[row - 1]
    assert not flagged(coloured)


def test_a_line_of_one_bpm_is_told_with_its_name_and_period(white, wave):
    white[:, 40] += 0.25 * wave
    (found,) = flagged(white).values()
    assert found.name == "line of a BPM"
    assert "B40" in found.note
    assert "every 17 ticks" in found.note


def test_a_faint_line_of_all_bpms_is_one_of_all(white, wave):
    white += 0.05 * wave[:, None] * np.random.default_rng(4).standard_normal(BPMS)
    assert set(flagged(white)) == {"line of all BPMs"}


def test_a_scatter_that_swells_again_and_again_is_a_rhythm(white, wave):
    (found,) = flagged(white * (1.0 + 0.03 * wave[:, None])).values()
    assert found.name == "rhythm of the scatter"
    assert "every 17 ticks" in found.note


def test_a_short_record_has_no_neighbours(white):
    assert line_tests(white[:120], NAMES, RATE) == ()
