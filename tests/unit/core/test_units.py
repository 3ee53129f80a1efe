"""Units as people, files and records write them: one table."""

import pytest

from orbitfb.core.units import CURRENT, ORBIT, PER_CURRENT, PER_KICK, plain, unit_factor


@pytest.mark.parametrize(
    ("written", "unit"),
    [
        ("A", "A"), ("Amps", "A"), ("amps", "A"), ("AMP", "A"), ("Ampere", "A"), ("amperes", "A"),
        ("a", "A"), ("mA", "mA"), ("MA", "mA"), ("milliamps", "mA"), ("mm", "mm"), ("MM", "mm"),
        ("µm", "um"), ("μm", "um"), ("micron", "um"), ("microns", "um"), ("Micrometers", "um"),
        ("millimetres", "mm"), ("nm", "nm"), ("metre", "m"), (" [mm] ", "mm"), ("(mm)", "mm"),
        ("mm/Ampere", "mm/A"), ("mm / A", "mm/A"), ("µm/mA", "um/mA"), ("mm per Amp", "mm/A"),
        ("mm A^-1", "mm/A"), ("mm A-1", "mm/A"), ("mm·A⁻¹", "mm/A"), ("microns per amp", "um/A"),
        ("mm/mrad", "mm/mrad"), ("seconds", "s"), ("µs", "us"), ("MHz", "MHz"), ("khz", "kHz"),
        ("A (setpoint change requested)", "A"), ("mm, turn by turn", "mm"),
        ("mm/A [model]", "mm/A"),
        ("inch", "inch"), ("datenum", "datenum"), ("", ""),
    ],
)  # fmt: skip
def test_a_unit_is_known_however_it_is_written(written, unit):
    assert plain(written) == unit


def test_sizes_are_in_si():
    assert pytest.approx(dict(ORBIT)) == {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9}
    assert pytest.approx(dict(CURRENT)) == {"A": 1.0, "mA": 1e-3}
    assert PER_CURRENT["mm/A"] == pytest.approx(1e-3)
    assert PER_CURRENT["um/mA"] == pytest.approx(1e-3)
    assert PER_KICK["mm/urad"] == pytest.approx(1e3)


@pytest.mark.parametrize(
    ("written", "base", "size"),
    [("Amps", "A", 1.0), ("microns", "m", 1e-6), ("mm/Ampere", "m/A", 1e-3), ("Ms", "s", 1e6),
     ("µs", "s", 1e-6), ("mm²", "m²", 1e-6)],
)  # fmt: skip
def test_words_do_for_effects_too(written, base, size):
    assert unit_factor(written, base) == pytest.approx(size)
