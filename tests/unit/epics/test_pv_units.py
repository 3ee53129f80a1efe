"""Units of PVs: as people write them, against the configuration."""

import numpy as np
import pytest
from pydantic import ValidationError

from orbitfb.epics.settings import EpicsSettings
from orbitfb.epics.units import (
    LENGTHS,
    corrector_contradiction,
    metres_of,
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
    metres, told = metres_of(NAMES, [other] * 3, (), unit)
    assert bool(told) == (unit != other)
    if told:
        assert f'set epics.bpm_unit = "{other}"' in told and "3 of 3" in told and "A, B, C" in told
    else:
        np.testing.assert_array_equal(metres, LENGTHS[unit])


def test_records_without_a_unit_contradict_nothing():
    metres, told = metres_of(NAMES, ["", "counts", "mm"], (), "mm")
    assert not told and metres.tolist() == [1e-3] * 3
    assert not corrector_contradiction(NAMES, ["", "A", "Amps"])


def test_mixed_units_and_other_currents_are_told():
    _, told = metres_of(NAMES, ["mm", "nm", "mm"], (), "mm")
    assert "1 of 3" in told and "B" in told and 'epics.bpm_unit = "egu"' in told
    assert "mA" in corrector_contradiction(NAMES, ["A", "mA", "A"])


def test_the_table_says_the_unit_of_each_and_the_record_must_not_contradict_it():
    metres, told = metres_of(NAMES, ["µm", "", "mm"], ("um", "nm", ""), "mm")
    assert not told and metres.tolist() == [1e-6, 1e-9, 1e-3]
    _, told = metres_of(NAMES, ["nm", "", "mm"], ("um", "nm", ""), "mm")
    assert "1 of 3 BPM PVs state nm" in told and "says um" in told and ": A;" in told
    assert "column unit" in told


def test_what_each_record_states_is_taken_if_that_is_wanted():
    metres, told = metres_of(NAMES, ["µm", "nm", "MM"], (), "egu")
    assert not told and metres.tolist() == [1e-6, 1e-9, 1e-3]
    for stated in ("", "counts"):
        _, told = metres_of(NAMES, ["um", stated, "mm"], (), "egu")
        assert "1 of 3 BPM PVs state no unit of length" in told and ": B;" in told
    metres, told = metres_of(NAMES, ["um", "", "mm"], ("", "nm", ""), "egu")
    assert not told and metres[1] == 1e-9


def test_one_that_is_away_and_has_no_unit_reads_nothing():
    here = np.array([True, False, True])
    metres, told = metres_of(NAMES, ["um", "", "mm"], (), "egu", here)
    assert not told and np.isnan(metres).tolist() == [False, True, False]


def test_a_comma_between_addresses_is_refused():
    for key in ("address_list", "name_servers"):
        with pytest.raises(ValidationError, match="separate addresses by blanks"):
            EpicsSettings(**{key: "10.0.0.1:5064,10.0.0.2"})
    assert EpicsSettings(address_list="a:1 b:2").address_list == "a:1 b:2"
