"""Units of PVs: as people write them, against the configuration."""

import pytest
from pydantic import ValidationError

from orbitfb.epics.settings import EpicsSettings
from orbitfb.epics.units import (
    LENGTHS,
    bpm_contradiction,
    corrector_contradiction,
    plain_unit,
)

NAMES = ("A", "B", "C")


@pytest.mark.parametrize(
    ("written", "plain"),
    [
        ("mm", "mm"),
        (" MM ", "mm"),
        ("µm", "um"),
        ("μm", "um"),
        ("microns", "um"),
        ("M", "m"),
        ("nm", "nm"),
        ("Amps", "a"),
        ("mA", "ma"),
        ("counts", "counts"),
    ],
)
def test_units_are_read_as_people_write_them(written: str, plain: str):
    assert plain_unit(written) == plain


@pytest.mark.parametrize("unit", list(LENGTHS))
@pytest.mark.parametrize("other", list(LENGTHS))
def test_every_other_unit_contradicts_and_the_key_is_named(unit: str, other: str):
    told = bpm_contradiction(NAMES, [other] * 3, unit)
    assert bool(told) == (unit != other)
    if told:
        assert f'set epics.bpm_unit = "{other}"' in told and "3 of 3" in told and "A, B, C" in told


def test_records_without_a_unit_contradict_nothing():
    assert not bpm_contradiction(NAMES, ["", "counts", "mm"], "mm")
    assert not corrector_contradiction(NAMES, ["", "A", "Amps"])


def test_mixed_units_and_other_currents_are_told():
    told = bpm_contradiction(NAMES, ["mm", "nm", "mm"], "mm")
    assert "1 of 3" in told and "B" in told and "one unit" in told
    assert "mA" in corrector_contradiction(NAMES, ["A", "mA", "A"])


def test_a_comma_between_addresses_is_refused():
    for key in ("address_list", "name_servers"):
        with pytest.raises(ValidationError, match="separate addresses by blanks"):
            EpicsSettings(**{key: "10.0.0.1:5064,10.0.0.2"})
    assert EpicsSettings(address_list="a:1 b:2").address_list == "a:1 b:2"
