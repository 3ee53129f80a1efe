"""Which devices stand together, told from names as laboratories give them."""

import pytest

from orbitfb.records.cells import cells_of


@pytest.mark.parametrize(
    ("pattern", "cell"),
    [
        ("PH{device}A_C{cell:02d}", "C{cell:02d}"),
        ("SR{cell:02d}C-DI-EBPM-{device:02d}", "SR{cell:02d}"),
        ("BPMZ{device}D{cell}R", "D{cell}"),
        ("srdiag/bpm/c{cell:02d}-{device:02d}", "c{cell:02d}"),
        ("R1-{cell:02d}-{device}/h", "{cell:02d}"),
    ],
)
def test_what_neighbours_share_is_the_cell(pattern, cell):
    there = [(one, device) for one in range(1, 9) for device in (1, 2, 3)]
    there = [*there[2:], *there[:2]]  # a ring may begin within a cell
    names = [pattern.format(cell=one, device=device) for one, device in there]
    wanted = [cell.format(cell=one) for one, _ in there]
    assert cells_of(names, "x" * 24) == tuple(wanted)
    both = [*names, *(name.replace("/h", "/v") for name in names)]
    assert cells_of(both, "x" * 24 + "y" * 24) == (*wanted, *wanted)


@pytest.mark.parametrize(
    "names",
    [
        [f"BPM{number:03d}" for number in range(24)],
        [f"BPM{number % 7}" for number in range(24)],
        [f"BPM-{number:x}-{number % 2}" for number in range(24)],
        ["left", "right", "up", "down"],
        ["SR01-BPM3"],
        [],
    ],
)
def test_names_that_do_not_say(names):
    assert cells_of(names, "x" * len(names)) == ("",) * len(names)
