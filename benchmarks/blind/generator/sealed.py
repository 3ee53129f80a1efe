"""The sealed truth of a suite, for who may open it."""

import hashlib
import json
import sys
from pathlib import Path
from typing import Any


def read_truth(folder: Path) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Read all truth files; what is not as it was hashed is refused.

    Raises:
        SystemExit: A file is missing or was changed since.
    """
    manifest = json.loads((folder / "manifest.json").read_text(encoding="utf-8"))
    truths = []
    for name, digest in manifest["files"].items():
        content = (folder / name).read_bytes()
        if hashlib.sha256(content).hexdigest() != digest:
            sys.exit(f"{folder / name}: not the truth that was hashed")
        truths.append(json.loads(content))
    return truths, manifest
