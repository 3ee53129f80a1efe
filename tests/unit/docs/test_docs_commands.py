"""Commands that the documentation shows: they exist, and so do their options.

The tutorials are run as a whole elsewhere; this is quick and looks at every page.
"""

import re
import shlex
from pathlib import Path

import pytest
import typer.main

from orbitfb.cli.app import app

ALL = typer.main.get_command(app)
ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
BLOCK = re.compile(r"```(?:console|sh)\n(.*?)```", re.DOTALL)
COMMAND = re.compile(r"^(?:\$ )?(?:\.venv/bin/)?orbitfb (.*)$", re.MULTILINE)


def shown():
    for page in PAGES:
        for block in BLOCK.findall(page.read_text(encoding="utf-8")):
            for line in COMMAND.findall(block.replace("\\\n", " ")):
                words = shlex.split(re.split(r" \||\$\(| > | && ", line)[0], comments=True)
                yield pytest.param(words, id=f"{page.stem}: {' '.join(words)[:50]}")


def unknown(words):
    """The first word that is no command or option there; None if all are."""
    command = ALL
    words = list(words)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        name = words[0]
        if name in command.commands:
            words.pop(0)
        elif "record" in command.commands:  # `diagnose RECORD` is `diagnose record RECORD`
            name = "record"
        elif getattr(command, "invoke_without_command", False):
            break
        else:
            return name
        command = command.commands[name]
    options = {name for each in command.params for name in (*each.opts, *each.secondary_opts)}
    for word in words:
        if word.startswith("--") and word.split("=")[0] not in {*options, "--help"}:
            return word
    return None


@pytest.mark.parametrize("words", [*shown()])
def test_a_shown_command_has_these_options(words):
    assert unknown(words) is None


def test_what_does_not_exist_is_seen():
    assert unknown(["run", "--ioc", "sim", "--drfit", "mild"]) == "--drfit"
    assert unknown(["policies", "lst"]) == "lst"
    assert unknown(["diagnose", "shift.npz", "--houldout", "b.npz"]) == "--houldout"
