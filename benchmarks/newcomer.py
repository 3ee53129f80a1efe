"""How long from `git clone` to the running loop, the page and the first diagnosis report?

    make newcomer        # or: python -m benchmarks.newcomer --out benchmarks/newcomer.json

Clones this repository's last commit into an empty directory and does there what the README says, in
an environment with nothing of the user's but what reaches the package registry: an empty home, and
no packages that were downloaded before.
"""

import argparse
import contextlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from benchmarks.circumstances import circumstances

ROOT = Path(__file__).parents[1]
KEPT = ("PIP_", "SSL_", "REQUESTS_", "HTTP", "http", "https", "NO_PROXY", "no_proxy")
"""Variables, by how they begin, without which no registry may be reached."""
RECORD = 30.0
"""How long the loop runs before it is diagnosed [s]."""
PATIENCE = 1800.0


def clean(home: Path) -> dict[str, str]:
    """The environment of somebody who has just logged in for the first time."""
    kept = {key: value for key, value in os.environ.items() if key.startswith(KEPT)}
    home.mkdir()
    path = f"{sys.base_prefix}/bin:/usr/local/bin:/usr/bin:/bin"
    return kept | {"HOME": str(home), "PATH": path, "LANG": "C.UTF-8"} | {
        "XDG_RUNTIME_DIR": str(home), "PIP_NO_CACHE_DIR": "1",
    }  # fmt: skip


class Watch:
    """Times since the beginning, by what was reached then."""

    def __init__(self) -> None:
        self._begin = time.monotonic()
        self.reached: dict[str, float] = {}

    def mark(self, what: str) -> None:
        self.reached[what] = round(time.monotonic() - self._begin, 1)
        print(f"{self.reached[what]:7.1f} s  {what}", flush=True)

    def until(self, what: str, look: Callable[[], object], running: subprocess.Popen[str]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not look():
            if running.poll() is not None or time.monotonic() > deadline:
                raise SystemExit(f"never reached: {what}; see terminal.txt")
            time.sleep(0.1)
        self.mark(what)


def page_answers(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5) as answer:
            return answer.status == 200
    except (urllib.error.URLError, OSError):
        return False


def journey(directory: Path) -> dict[str, Any]:
    """Do what the README says; when each thing was there [s], and what was installed."""
    environment = clean(directory / "home")
    clone, terminal = directory / "orbitfb", directory / "terminal.txt"
    watch = Watch()
    subprocess.run(["git", "clone", "--quiet", f"file://{ROOT}", str(clone)], check=True)
    watch.mark("cloned")
    with terminal.open("w") as output:
        loop = subprocess.Popen(
            ["make", "run"], cwd=clone, env=environment, stdout=output, stderr=output, text=True,
            start_new_session=True,
        )  # fmt: skip
    try:
        installed = clone / ".venv/.installed"
        watch.until("installed", installed.exists, loop)
        watch.until("loop CLOSED", lambda: "state: CLOSED" in terminal.read_text(), loop)
        page = "http://127.0.0.1:9181/"
        watch.until("operator page", lambda: page_answers(page), loop)
        time.sleep(RECORD)
        watch.mark(f"{RECORD:.0f} s recorded")
        ask = [".venv/bin/orbitfb", "diagnose", "orbitfb-data/archive", "--out", "answer"]
        said = subprocess.run(
            ask, cwd=clone, env=environment, check=True, capture_output=True, text=True
        )
        if not (clone / "answer/report.html").is_file():
            raise SystemExit("there is no report")
        watch.mark("first diagnosis report")
        print(said.stdout.splitlines()[0])
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(loop.pid, signal.SIGINT)
            loop.wait(20)
            os.killpg(loop.pid, signal.SIGKILL)
        print(terminal.read_text()[-2000:] if "first diagnosis report" not in watch.reached else "")
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    freeze = [".venv/bin/python", "-m", "pip", "freeze"]
    packages = subprocess.run(
        freeze, cwd=clone, env=environment, check=True, capture_output=True, text=True
    ).stdout.split()
    return {
        "seconds": watch.reached,
        "cpu_seconds": round(used.ru_utime + used.ru_stime, 1),  # of all processes together
        "installed": len(packages),
        "torch": next(name for name in packages if re.match("torch(==|@)", name)),
        "wheels_from_this_disk": bool(environment.get("PIP_FIND_LINKS")),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    document: dict[str, Any] = {**circumstances("make newcomer", 1, quick=False)}
    with tempfile.TemporaryDirectory(prefix="newcomer-") as directory:
        document |= journey(Path(directory))
    arguments.out.write_text(json.dumps(document, indent=1) + "\n")


if __name__ == "__main__":
    main()
