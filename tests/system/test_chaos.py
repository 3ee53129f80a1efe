"""A short campaign of seeded faults on the real service, judged at the IOC; the plain loop beside.

The whole one is `make chaos`.
"""

from pathlib import Path

import pytest

from tests.chaos.judge import broken_rules
from tests.chaos.once import run_once

pytestmark = [pytest.mark.system, pytest.mark.timing, pytest.mark.nightly]

SEED, FAULTS, RATE = 16, 6, 40.0


def test_a_short_campaign_breaks_no_rule(tmp_path: Path):
    result = run_once(tmp_path / "chaos", SEED, FAULTS, RATE)
    assert result["broken"] == []
    assert result["faults"] == FAULTS
    assert result["ours"]["orbits written on"] > 20
    assert result["held"] > 0
    # The judge sees what a loop without rules does under the same faults.
    assert broken_rules(result["naive"])
