"""What errors say."""

from orbitfb.core.errors import MOST_SHOWN, ConnectError, few


def test_many_names_are_shown_in_part_and_counted():
    names = [f"PV{number}" for number in range(542)]
    error = ConnectError(names, 600, 2.0, "Look there.")
    first, *shown, rest, advice = str(error).splitlines()
    assert first == "542 of 600 PVs did not connect within 2.0 s:"
    assert [name.strip() for name in shown] == names[:MOST_SHOWN]
    assert rest.strip() == f"… and {542 - MOST_SHOWN} more"
    assert advice == "Look there."
    assert error.missing == tuple(names)


def test_few_names_are_shown_all():
    names = [f"PV{number}" for number in range(MOST_SHOWN)]
    assert few(names).split() == names
