"""Unknown laws of devices, on records without one."""

from pathlib import Path

from benchmarks.blind.generator.generate import write_case
from benchmarks.blind.generator.suites import plan
from orbitfb.diagnose.hypotheses.free_course import scan_free
from orbitfb.diagnose.hypotheses.scores import Scorer
from orbitfb.diagnose.likelihood.workspace import Workspace
from orbitfb.effects.registry import effect
from orbitfb.estimation.priors import SURE
from orbitfb.records.reading.load import load

SEED, CASE = 201, 30
KINDS = ("bpm-gain", "corrector-gain", "quadrupole-gradient")


def test_noise_of_the_first_readings_is_no_law_of_all_bpms(tmp_path: Path) -> None:
    """The orbit hardly moves beside it: its cube had 36 nats, nearly all in the first four rows."""
    for folder in ("truth", "later"):
        (tmp_path / folder).mkdir()
    write_case(list(plan("healthy", SEED))[CASE], "case", tmp_path, tmp_path / "truth", SEED)
    record = load(tmp_path / "case.npz", planes=None, ring=None).record
    found = scan_free(Scorer.of(Workspace.of(record, [effect(one) for one in KINDS])))
    assert max(one.evidence for one in found) < SURE
