"""The diagnosis of another checkout, asked beside that of this one."""

from pathlib import Path

import pytest

from benchmarks.blind.engines import EngineError, installed
from benchmarks.blind.many import write
from benchmarks.blind.rivals.checkout import VARIABLE, diagnose

ROOT = Path(__file__).parents[3]


def test_this_checkout_says_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = tmp_path / "records" / f"{write('short', 'healthy', 1, tmp_path / 'records')}.npz"
    monkeypatch.setenv(VARIABLE, str(ROOT))
    answer = diagnose(record, without=("corrector-gain",))
    mine = installed(record, without=("corrector-gain",))
    assert (answer["state"], answer["tournament"]) == (mine["state"], mine["tournament"])


def test_without_a_checkout_it_says_what_to_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    with pytest.raises(EngineError, match=f"{VARIABLE} is not set: give the folder"):
        diagnose(tmp_path / "record.npz")
    monkeypatch.setenv(VARIABLE, str(ROOT))
    with pytest.raises(EngineError, match=r"it gives no answer to .*record\.npz"):
        diagnose(tmp_path / "record.npz")
