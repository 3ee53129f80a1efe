"""A scan of crates goes on where no strength that would be seen is one that the effect can have."""

from record_files import record

from orbitfb.diagnose import strike_scan
from orbitfb.diagnose.bench import Bench
from orbitfb.effects.registry import effect


def test_crates_without_a_strength_to_try_are_no_candidates(monkeypatch):
    monkeypatch.setattr(strike_scan, "_latent_grid", lambda kind, score, info: iter(()))
    assert strike_scan.latent_candidates(Bench(record()), effect("missed-write")) == []
