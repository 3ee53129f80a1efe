"""What the image does, done without a container engine: the wheel in a clean environment.

The environment gets orbitfb from the wheel, and the packages that it needs from the one that runs
the tests; the program runs as a user without any rights.
"""

import email
import importlib.util
import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

pytestmark = pytest.mark.system

ROOT = Path(__file__).parents[2]
NOBODY = 65534


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    """A directory that every user can reach."""
    with tempfile.TemporaryDirectory(prefix="orbitfb-installed-") as name:
        path = Path(name)
        path.chmod(0o755)
        yield path


@pytest.fixture(scope="module")
def wheel(place: Path) -> Path:
    """The wheel, built as the Dockerfile does, from what the Dockerfile copies."""
    source = place / "source"
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    shutil.copytree(
        ROOT / "orbitfb", source / "orbitfb", ignore=shutil.ignore_patterns("__pycache__")
    )
    pip, environment = [sys.executable, "-m", "pip"], dict(os.environ)
    if importlib.util.find_spec("hatchling") is None:
        environment["PYTHONPATH"] = backend = str(place / "backend")
        fetch = [*pip, "install", "--quiet", "--target", backend, "hatchling"]
        fetch += ["--constraint", str(ROOT / "constraints.txt")]
        done = subprocess.run(fetch, capture_output=True, text=True, check=False, timeout=100)
        if done.returncode:
            why = (done.stderr.strip() or "it does not say why").splitlines()[-1]
            pytest.skip(f"hatchling is not installed and pip cannot fetch it: {why}")
    build = [*pip, "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    build += ["--wheel-dir", str(place / "wheels"), str(source)]
    subprocess.run(build, env=environment, check=True, timeout=120)
    [built] = (place / "wheels").glob("orbitfb-*.whl")
    return built


def reachable_python() -> str:
    """Give a Python of this version that a user without rights can start."""
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for path in (os.path.realpath(sys.executable), f"/usr/bin/{name}", f"/usr/local/bin/{name}"):
        if os.getuid() != 0:
            return path
        try:
            done = subprocess.run(
                [path, "-c", ""], user=NOBODY, group=NOBODY, extra_groups=[], check=False, cwd="/"
            )
        except OSError:
            continue
        if done.returncode == 0:
            return path
    pytest.skip(f"no {name} that a user without rights can start (install Debian's {name})")


@pytest.fixture(scope="module")
def installed(place: Path, wheel: Path) -> Path:
    """The environment; gives its directory."""
    where = place / "environment"
    python = reachable_python()
    subprocess.run([python, "-m", "venv", "--without-pip", where], check=True, timeout=60)
    [site] = (where / "lib").glob("python*/site-packages")
    pip = [sys.executable, "-m", "pip", "--python", where / "bin/python", "install", "--quiet"]
    subprocess.run([*pip, "--no-deps", "--no-compile", wheel], check=True, timeout=120)
    (site / "beside.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    return where


def as_nobody(installed: Path, *arguments: object, **more: str) -> subprocess.Popen[str]:
    """Start the program as a user without rights, in a bare environment."""
    home = installed.parent / "home"
    if not home.exists():
        (home / "run").mkdir(parents=True)
        if os.getuid() == 0:
            for path in (home, home / "run"):
                os.chown(path, NOBODY, NOBODY)
    user = {"user": NOBODY, "group": NOBODY, "extra_groups": []} if os.getuid() == 0 else {}
    environment = {
        "PATH": f"{installed}/bin:/usr/bin:/bin",
        "HOME": str(home),
        "XDG_RUNTIME_DIR": str(home / "run"),
        "MPLCONFIGDIR": str(home / "matplotlib"),
        "ORBITFB_DATA_DIRECTORY": str(home / "data"),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    return subprocess.Popen(
        ["orbitfb", *map(str, arguments)],
        executable=str(installed / "bin/orbitfb"),
        cwd=home,
        env=environment | more,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **user,
    )


def finished(process: subprocess.Popen[str]) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=60)
    return process.returncode, out, err


def test_the_wheel_holds_the_package_its_data_and_its_entry_point(wheel: Path):
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
        [metadata] = [name for name in names if name.endswith(".dist-info/METADATA")]
        about = email.message_from_bytes(archive.read(metadata))
        [entries] = [name for name in names if name.endswith("entry_points.txt")]
        assert "orbitfb = orbitfb.cli.app:main" in archive.read(entries).decode()
    sources = {
        str(path.relative_to(ROOT))
        for path in (ROOT / "orbitfb").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert sources == {name for name in names if name.startswith("orbitfb/")}
    assert {"orbitfb/data/places.csv", "orbitfb/data/ring.json", "orbitfb/py.typed"} <= names
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert (about["Version"], about["License-Expression"]) == (project["version"], "BSD-3-Clause")
    assert set(project["optional-dependencies"]) == set(about.get_all("Provides-Extra"))


def test_the_entry_point_runs_the_installed_package_as_nobody(installed: Path):
    code, out, err = finished(as_nobody(installed, "--version"))
    assert (code, err) == (0, "") and out.strip()
    python = subprocess.run(
        [installed / "bin/python", "-I", "-c", "import orbitfb; print(orbitfb.__file__)"],
        capture_output=True,
        text=True,
        check=True,
        timeout=30,
        cwd="/",
    )
    assert python.stdout.startswith(str(installed))


def test_service_and_health_run_as_nobody(installed: Path):
    config = installed.parent / "orbitfb.toml"
    text = (ROOT / "deploy/orbitfb.toml").read_text()
    text = text.replace("/etc/orbitfb/access.toml", str(ROOT / "deploy/epics/access.toml"))
    config.write_text(f"{text}port = 0\n")  # of the panel, the last table
    config.chmod(0o644)
    ports = {f"ORBITFB_{part}__PORT": "0" for part in ("OBSERVE", "SIM", "WEB")}
    service = as_nobody(installed, "run", "--ioc", "sim", "--config", config, **ports)
    try:
        log = installed.parent / "home/data/orbitfb.log.jsonl"
        port = _port(log, service)
        deadline = time.monotonic() + 30.0
        ask = ("health", "--ready", "--port", port)
        while finished(as_nobody(installed, *ask))[0] and time.monotonic() < deadline:
            time.sleep(0.2)
        code, out, err = finished(as_nobody(installed, *ask))
        assert (code, err) == (0, "") and out.startswith("ready: ")
        code, out, _ = finished(as_nobody(installed, "command", "status", "--json"))
        assert code == 0 and json.loads(out)["state"] in ("OPEN", "CLOSED")
        if os.getuid() == 0:
            status = Path(f"/proc/{service.pid}/status").read_text()
            assert f"Uid:\t{NOBODY}" in status
    finally:
        service.send_signal(signal.SIGTERM)
        code, _, err = finished(service)
    assert code == 0, err
    code, out, _ = finished(as_nobody(installed, "health", "--port", port))
    assert code == 1 and out.startswith("not alive: no answer")


def _port(log: Path, service: subprocess.Popen[str]) -> str:
    """Wait for the start, and give the port of /healthz."""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        assert service.poll() is None, service.communicate()
        if log.exists():
            for line in log.read_text().splitlines():
                event = json.loads(line)
                if event["event"] == "service_started":
                    return event["metrics"].rpartition(":")[2]
        time.sleep(0.1)
    raise AssertionError("it did not start")
