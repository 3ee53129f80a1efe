"""One loop of a user on a ring, each plane of it by itself."""

from contextlib import ExitStack

import pytest

from orbitfb.app.setup.startup import take_ring
from orbitfb.core.errors import OwnershipError
from orbitfb.epics.settings import EpicsSettings
from orbitfb.physics.places import Planes, Ring

RING = Ring.load()
HERE = EpicsSettings(address_list="127.0.0.1", server_port=15999)


def take(planes: Planes, stack: ExitStack, settings: EpicsSettings = HERE) -> None:
    take_ring(settings, RING.channels(planes), stack)


@pytest.mark.parametrize(("one", "other", "plane"), [("xy", "y", "y"), ("x", "xy", "x")])
def test_whoever_has_both_planes_has_each_of_them(one: Planes, other: Planes, plane: str):
    with ExitStack() as first:
        take(one, first)
        with (
            ExitStack() as second,
            pytest.raises(OwnershipError, match=f"port 15999, plane {plane} is held by another"),
        ):
            take(other, second)
    with ExitStack() as later:
        take(other, later)


def test_two_planes_may_have_two_loops_and_two_names_are_one_host():
    with ExitStack() as first, ExitStack() as second:
        take("x", first)
        take("y", second)
        named = HERE.model_copy(update={"address_list": "localhost"})
        with ExitStack() as third, pytest.raises(OwnershipError, match="plane x is held"):
            take("x", third, named)
