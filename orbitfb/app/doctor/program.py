"""Python, the packages, torch and its GPU: what the program runs on."""

import importlib
import importlib.metadata
import platform
import sys
from collections.abc import Iterator
from typing import Any

from packaging.requirements import Requirement

from orbitfb import __version__
from orbitfb.app.doctor.finding import Finding, Verdict

_PART = "program"
_PYTHON = (3, 11)
_EXTRAS = ("parquet", "rl", "cluster", "web")
"""Extras that are told of; those for development are not."""


def look_at_program() -> Iterator[Finding]:
    """Look at Python and at the packages, those of installed extras included."""
    version = platform.python_version()
    fits = sys.version_info[:2] >= _PYTHON
    yield Finding(
        _PART,
        "python",
        Verdict.OK if fits else Verdict.FAILED,
        f"{version} on {platform.system()} {platform.release()} {platform.machine()}",
        "" if fits else f"install Python {'.'.join(map(str, _PYTHON))} or later",
        {"version": version, "executable": sys.executable},
    )
    yield _packages()
    yield _torch()


def _packages() -> Finding:
    versions, wrong, extras = {"orbitfb": __version__}, [], []
    try:
        requires = [Requirement(text) for text in importlib.metadata.requires("orbitfb") or ()]
    except importlib.metadata.PackageNotFoundError:
        return Finding(_PART, "packages", Verdict.FAILED, "orbitfb is not installed by pip",
                       "pip install orbitfb, or make venv in its repository")  # fmt: skip
    for wanted in requires:
        extra = next((e for e in _EXTRAS if f'extra == "{e}"' in str(wanted.marker)), None)
        if (
            wanted.marker is not None
            and extra is None
            and not wanted.marker.evaluate({"extra": ""})
        ):
            continue  # for development
        try:
            found = importlib.metadata.version(wanted.name)
        except importlib.metadata.PackageNotFoundError:
            if extra is None:
                wrong.append(f"{wanted.name} is missing")
            continue
        versions[wanted.name] = found
        if extra is not None:
            extras.append(extra)
        if not wanted.specifier.contains(found, prereleases=True):
            wrong.append(f"{wanted.name} {found} is not {wanted.specifier}")
    present = f", extras {', '.join(dict.fromkeys(extras))}" if extras else ""
    return Finding(
        _PART,
        "packages",
        Verdict.FAILED if wrong else Verdict.OK,
        "; ".join(wrong) or f"orbitfb {__version__}, {len(versions) - 1} packages{present}",
        "pip install --upgrade 'orbitfb'" if wrong else "",
        {"versions": versions},
    )


def _torch() -> Finding:
    try:
        torch: Any = importlib.import_module("torch")
    except (ImportError, OSError) as error:
        return Finding(_PART, "torch", Verdict.FAILED, str(error)[:200], "install torch again")
    figures: dict[str, Any] = {"version": torch.__version__, "threads": torch.get_num_threads()}
    if not torch.cuda.is_available():
        figures["gpu"] = None
        return Finding(_PART, "torch", Verdict.OK, f"{torch.__version__}, no GPU (none is needed "
                       "for the loop)", figures=figures)  # fmt: skip
    name = torch.cuda.get_device_name(0)
    figures["gpu"] = {"name": name, "memory_bytes": torch.cuda.mem_get_info()[1]}
    return Finding(_PART, "torch", Verdict.OK, f"{torch.__version__}, {name}", figures=figures)
