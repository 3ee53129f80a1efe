"""What the experiment leaves behind: table, figures and page."""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from orbitfb.core.errors import ConfigError
from orbitfb.evaluate.paper.report.modes_picture import draw_modes
from orbitfb.evaluate.paper.report.page import page
from orbitfb.evaluate.paper.report.pictures import draw_orbits, draw_training
from orbitfb.evaluate.paper.report.table import document, markdown
from orbitfb.evaluate.paper.run import PaperResult

_SHORT = 500


def prepare(directory: Path) -> None:
    """Make the directory, before hours of work are spent for it.

    Raises:
        ConfigError: It cannot be made or nothing can be written there.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe = directory / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ConfigError(
            f"--out {directory}: {error.strerror}; name a directory that can be written"
        ) from error


def write(result: PaperResult, directory: Path) -> dict[str, Any]:
    """Write `table.json`, `table.md`, the figures and `index.html`.

    Args:
        result: What was run.
        directory: Where.

    Returns:
        What `table.json` holds.
    """
    table = document(result)
    text = json.dumps(table, indent=1, allow_nan=False)
    (directory / "table.json").write_text(text + "\n", encoding="utf-8")
    (directory / "table.md").write_text(markdown(table), encoding="utf-8")
    pictures = _draw(result, directory)
    (directory / "index.html").write_text(page(table, pictures), encoding="utf-8")
    return table


def _draw(result: PaperResult, directory: Path) -> dict[str, Path]:
    """Draw all figures; a caption begins with the scenario that it belongs to."""
    pictures: dict[str, Path] = {}

    def add(caption: str, name: str, draw: Callable[[Path], None]) -> None:
        path = directory / name
        draw(path)
        pictures[caption] = path

    for name, methods in result.methods.items():
        scenario = result.scenarios[name]
        add(
            f"{name}: the first {min(_SHORT, scenario.steps)} ticks",
            f"{name}-short.png",
            lambda path, s=scenario, m=methods: draw_orbits(s, m, _SHORT, path),
        )
        add(
            f"{name}: the whole drift and the re-kick",
            f"{name}-long.png",
            lambda path, s=scenario, m=methods: draw_orbits(s, m, None, path),
        )
        if "svd" in methods and not scenario.physical:
            add(
                f"{name}: modes that the static law loses",
                f"{name}-modes.png",
                lambda path, s=scenario: draw_modes(s, path),
            )
    curves: dict[str, Sequence[float]] = {
        f"{method}, {name}": one.training["curve"]
        for name, methods in result.methods.items()
        for method, one in methods.items()
        if one.training.get("curve")
    }
    if curves:
        add("Trainings", "training.png", lambda path: draw_training(curves, path))
    return pictures
