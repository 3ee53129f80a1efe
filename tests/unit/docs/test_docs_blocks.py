"""Every block of every page is one that a test runs or checks, or says why not.

`tests/system/test_docs_snippets.py` runs them; the rules are in `tests/docs_pieces.py`.
"""

import ast
import json
import re
import tomllib
from pathlib import Path

import pytest
import yaml
from docs_pieces import ALONE, COMMANDS, KINDS, PAGES, ROOT, WITH_BLOCK, commands, file_name, pieces

from orbitfb.config.tree import AppConfig
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect

TYPED = re.compile(
    r"^(\$ |(?:\.venv/bin/)?orbitfb [a-z]|(make|pip|git|curl|caget|caput|docker|kubectl) [a-z-])",
    re.MULTILINE,
)
EFFECTS = sorted((ROOT / "docs/reference/effects").glob("*.md"))


def problems(text):
    """What is wrong with the blocks of a page, by line."""
    found = list(pieces(text))
    if text.count("```") != 2 * sum(piece.kind != "alone" for piece in found):
        yield "a block that is not closed, or has no place of its own"
    for piece in found:
        try:
            said = problem(piece)
        except (SyntaxError, ValueError, yaml.YAMLError) as error:
            said = str(error)
        if said:
            yield f"line {piece.line}: {said}"


def problem(piece):
    words = [order.split(",")[0].split(" ")[0] for order in piece.orders]
    known = ALONE if piece.kind == "alone" else WITH_BLOCK
    if unknown := set(words) - set(known):
        return f"no such order: {sorted(unknown)}"
    if "skip" in words and len(piece.order("skip")) < 8:
        return "skipped without a reason"
    if piece.kind == "alone":
        return None
    if piece.kind not in KINDS:
        return f"'{piece.kind}' is no kind of block, see tests/docs_pieces.py"
    if piece.kind == "text" and TYPED.search(piece.body):
        return "a text block with something to type: make it sh or console"
    if "other" in words and piece.kind != "toml":
        return "only a toml block can be other than a configuration"
    if piece.kind in COMMANDS and not commands(piece.body):
        return "a block without a command"
    checks = {"python": ast.parse, "json": json.loads, "yaml": yaml_problem, "toml": toml_problem}
    if "other" in words:
        checks["toml"] = tomllib.loads
    wrong = checks.get(piece.kind, lambda _: None)(piece.body)
    return wrong if isinstance(wrong, str) else None


def yaml_problem(body):
    list(yaml.safe_load_all(body))


def toml_problem(body):
    AppConfig.model_validate_json(json.dumps(tomllib.loads(body)), strict=True)
    return None if file_name(body) else "a toml block that does not begin with `# NAME.toml`"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_block_is_run_or_checked_or_says_why_not(page):
    assert not [*problems(page.read_text(encoding="utf-8"))]


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        ("```\nx\n```\n", "no kind of block"),
        ("```bash\nx\n```\n", "no kind of block"),
        ("```text\n$ orbitfb run\n```\n", "something to type"),
        ("```text\norbitfb run --ioc sim\n```\n", "something to type"),
        ("<!-- test: skip -->\n```sh\nx\n```\n", "without a reason"),
        ("<!-- test: jump -->\n```sh\nx\n```\n", "no such order"),
        ("<!-- test: other -->\n```sh\nx\n```\n", "only a toml block"),
        ("```sh\n# nothing\n```\n", "without a command"),
        ("```python\nif\n```\n", "invalid syntax"),
        ("```toml\n[loop]\nrate_hz = 1.0\n```\n", "does not begin with"),
        ("```toml\n# a.toml\n[loop]\nrate = 1\n```\n", "rate"),
        ("```json\n{\n```\n", "line 1"),
        ("```sh\nx\n", "not closed"),
    ],
)
def test_a_block_that_nobody_checks_is_seen(text, wrong):
    assert wrong in "".join(problems(text))


@pytest.mark.parametrize("page", EFFECTS, ids=lambda page: page.stem)
def test_the_command_of_an_effect_is_accepted(page: Path):
    blocks = [p.body for p in pieces(page.read_text(encoding="utf-8")) if p.kind == "sh"]
    command = re.compile(r"^orbitfb run --ioc sim --effect (\S+)(?: --planes xy)?$", re.MULTILINE)
    (spec,) = command.findall("".join(blocks))
    assert parse_effect(spec).id in all_effects()
