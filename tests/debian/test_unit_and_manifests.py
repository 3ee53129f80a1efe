"""What systemd and kubectl themselves say of the unit and the manifests."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

pytestmark = pytest.mark.system

DEPLOY = Path(__file__).parents[2] / "deploy"
WORST_EXPOSURE = 2.0
"""systemd's figure: 10 is wide open, 0 closed."""


def needs(program: str) -> str:
    """Skip where a program is not installed."""
    found = shutil.which(program)
    if found is None:
        pytest.skip(f"{program} is not installed")
    return found


@pytest.fixture
def unit(tmp_path: Path) -> Path:
    """The unit, with a program that is here."""
    path = tmp_path / "orbitfb.service"
    text = (DEPLOY / "systemd/orbitfb.service").read_text()
    program = Path(sys.executable).with_name("orbitfb")
    path.write_text(text.replace("/opt/orbitfb/bin/orbitfb", str(program)))
    return path


def run(*command: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [*map(str, command)], capture_output=True, text=True, timeout=60, check=False
    )


def test_systemd_finds_nothing_wrong_with_the_unit(unit: Path):
    done = run(needs("systemd-analyze"), "verify", unit)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


def test_systemd_finds_what_is_wrong(unit: Path):
    unit.write_text(unit.read_text().replace("Restart=on-failure", "Restart=sometimes"))
    done = run(needs("systemd-analyze"), "verify", unit)
    assert "sometimes" in done.stderr


def test_the_unit_exposes_little(unit: Path):
    done = run(needs("systemd-analyze"), "security", "--offline=true", "--no-pager", unit)
    found = re.search(r"Overall exposure level for orbitfb.service: ([\d.]+)", done.stdout)
    assert found and float(found[1]) <= WORST_EXPOSURE


def test_kubectl_builds_the_manifests():
    done = run(needs("kubectl"), "kustomize", DEPLOY / "kubernetes")
    assert done.returncode == 0, done.stderr
    resources = list(yaml.safe_load_all(done.stdout))
    assert sorted(its["kind"] for its in resources) == [
        "ConfigMap",
        "ConfigMap",
        "Namespace",
        "StatefulSet",
    ]
    placed = [its for its in resources if its["kind"] != "Namespace"]
    assert {its["metadata"]["namespace"] for its in placed} == {"orbitfb"}
