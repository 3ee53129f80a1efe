"""The command on the page of an effect can be given, and strikes no more than it must."""

import re

import pytest

from orbitfb.effects.build import build, layout_of
from orbitfb.effects.pages import effect_page
from orbitfb.effects.places import resolve
from orbitfb.effects.registry import all_effects
from orbitfb.effects.settings import parse_effect
from orbitfb.physics.places import Ring

MOST = 4
"""Columns of two devices in two planes."""


@pytest.mark.parametrize("name", [*all_effects()])
def test_the_command_of_a_page_works(name):
    kind = all_effects()[name]
    [(text, planes)] = re.findall(
        r"^orbitfb run --ioc sim --effect (\S+)(?: --planes (\S+))?$", effect_page(name, ""), re.M
    )
    layout, its = layout_of(Ring.load(), planes or "x", 0.1), parse_effect(text)
    assert len(build([its], layout, seed=1)) == 1
    if kind.target != "ring" and kind.stage not in ("noise", "timing"):
        assert 1 <= len(resolve(its, layout)) <= MOST
