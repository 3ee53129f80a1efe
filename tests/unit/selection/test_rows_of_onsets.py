"""The row at which a law begins, where motion of the ring hides it."""

from pathlib import Path

import pytest

from benchmarks.blind.many import write
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.diagnose.selection.rounds import tournament
from orbitfb.effects.registry import all_effects
from orbitfb.records.reading.load import load


@pytest.mark.parametrize("machine", ["shaking", "one-shaking"])
def test_a_corrector_that_is_stuck_is_no_second_cause(machine: str, tmp_path: Path) -> None:
    """A floor that knows of no shaking takes a wrong row for as good, and that leaves kicks."""
    name = write(machine, "stuck", 10, tmp_path / "records")
    record = load(tmp_path / "records" / f"{name}.npz", planes=None, ring=None).record
    kinds = [one for one in all_effects().values() if not one.unavailable(record)]
    accepted, _ = tournament(Workspace.of(record, kinds), kinds)
    assert [one.kind.id for one in accepted] == ["corrector-stuck"]
