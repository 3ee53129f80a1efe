"""What takes above a second of computing is nightly: the files and tests of `nightly.txt`."""

from pathlib import Path

import pytest

HERE = Path(__file__).parent
NIGHTLY = frozenset((HERE / "nightly.txt").read_text(encoding="utf-8").split())
"""Names of files, `test_x.py`, and of tests with all their parameters, `test_x.py::test_y`."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what the list names."""
    for item in items:
        if item.path.parent == HERE:
            name = getattr(item, "originalname", item.name)
            if not NIGHTLY.isdisjoint((item.path.name, f"{item.path.name}::{name}")):
                item.add_marker(pytest.mark.nightly)
