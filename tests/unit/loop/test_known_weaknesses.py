"""What is known to go wrong with orbit feedbacks has a test here, by name."""

import re
from pathlib import Path

import pytest

TESTS = Path(__file__).parents[2]

WEAKNESSES = {
    "a frozen orbit is integrated": "test_a_frozen_orbit_is_not_integrated",
    "a BPM that reads NaN counts as on reference": "test_a_nan_bpm_is_not_read_as_on_reference",
    "setpoints run away from a dead corrector": (
        "test_a_dead_corrector_does_not_let_setpoints_and_hardware_part_ways"
    ),
    "an aborted measurement leaves the setpoints anywhere": (
        "test_an_aborted_matrix_measurement_leaves_no_trace"
    ),
    "the dead band looks at one sign": "test_the_dead_band_looks_at_both_signs",
    "NaN passes a clamp": "test_nan_does_not_pass_a_clamp",
}
ON_A_REAL_IOC = (
    "test_a_frozen_orbit_is_not_integrated",
    "test_a_nan_bpm_is_not_read_as_on_reference",
    "test_a_dead_corrector_does_not_let_setpoints_and_hardware_part_ways",
    "test_an_aborted_matrix_measurement_leaves_no_trace",
)


def names_in(directory: Path) -> set[str]:
    files = directory.rglob("test_*.py")
    return {
        name for file in files for name in re.findall(r"^def (test_\w+)", file.read_text(), re.M)
    }


@pytest.mark.parametrize("name", WEAKNESSES.values(), ids=WEAKNESSES)
def test_every_known_weakness_has_its_test(name: str):
    assert name in names_in(TESTS)
    if name in ON_A_REAL_IOC:
        assert name in names_in(TESTS / "system")
