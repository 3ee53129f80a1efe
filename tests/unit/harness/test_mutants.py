"""The table of broken safety rules fits the code; `make nightly` runs it."""

import ast

import pytest

from tests.mutants.rules import MUTANTS, ROOT, Mutant


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.rule)
def test_each_can_be_broken_and_its_tests_are_there(mutant: Mutant):
    broken = mutant.broken((ROOT / mutant.file).read_text(encoding="utf-8"))
    ast.parse(broken)
    assert mutant.tests
    for path in mutant.paths:
        assert (ROOT / path).is_file(), path


def test_each_rule_stands_there_once_and_in_every_part_of_the_loop():
    rules = [mutant.rule for mutant in MUTANTS]
    assert len(set(rules)) == len(rules) >= 25
    assert {mutant.module.split(".")[1] for mutant in MUTANTS} >= {"safety", "loop", "epics"}


def test_a_text_that_is_gone_or_there_twice_is_told():
    mutant = Mutant("a rule", "orbitfb.safety.limits", "if x:", "if True:", ())
    assert mutant.broken("if x:") == "if True:"
    for text in ("", "if x: pass\nif x: pass"):
        with pytest.raises(ValueError, match="a rule"):
            mutant.broken(text)
