"""A label of a metric has few values, however many incidents there are."""

import pytest

from orbitfb.observe.statistics.tallies import kind_of


@pytest.mark.parametrize(
    "reasons",
    [
        [f"the orbit is stamped {0.3 * k:.1f} s in the future" for k in range(1, 16)],
        [f"{k} of 180 BPMs carry stamp 1790000000.{k:03d}, PH1A_C{k:02d} still at {k}.5"
         for k in range(1, 16)],
        [f"rms orbit error {1.1**k:.4g} µm exceeds 1000 µm" for k in range(15)],
        [", ".join(f"CH1A_C{j:02d}" for j in range(2, 3 + k)) + " do not follow"
         for k in range(1, 9)],
    ],
)  # fmt: skip
def test_incidents_of_one_kind_have_one_reason(reasons: list[str]):
    kinds = {kind_of(reason) for reason in reasons}
    assert len(kinds) == 1
    assert not any(sign.isdigit() for sign in kinds.pop())


def test_kinds_stay_apart():
    kinds = {kind_of(r) for r in ("rms orbit error 3 µm exceeds 2 µm", "no orbit for 3 s", "")}
    assert len(kinds) == 3
