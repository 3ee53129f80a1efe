"""What the experiment leaves behind: `table.json`, `table.md`."""

import json
from pathlib import Path
from typing import Any

from orbitfb.core.errors import ConfigError
from orbitfb.evaluate.paper.run import PaperResult
from orbitfb.evaluate.paper.table import document, markdown


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
    """Write everything.

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
    return table
