"""Names that are elements of arrays are gathered into PVs."""

import pytest

from orbitfb.core.names import named_pvs


def told(names):
    return [
        (pv.name, pv.places.tolist(), None if pv.elements is None else pv.elements.tolist())
        for pv in named_pvs(names)
    ]


def test_elements_of_one_array_share_a_pv_in_the_order_of_the_names():
    assert told(["A.[2]", "B", "A.VAL[0]", "A.[1]"]) == [
        ("A", [0, 2, 3], [2, 0, 1]),
        ("B", [1], None),
    ]


@pytest.mark.parametrize("name", ["A[2]", "A.[-1]", "A.[1:3]", "A.[]", "SR:C30-BI{BPM:1}Pos:X-I"])
def test_other_names_are_scalars_as_they_stand(name):
    assert told([name]) == [(name, [0], None)]


def test_an_array_is_whole_if_each_value_up_to_the_last_has_a_name():
    assert named_pvs(["A.[1]", "A.[0]"])[0].is_whole
    assert not named_pvs(["A.[1]", "A.[2]"])[0].is_whole
    assert named_pvs(["A.[4]"])[0].length == 5
    assert named_pvs(["A"])[0].length == 1
