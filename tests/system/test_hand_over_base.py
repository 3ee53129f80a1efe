"""Our reference, handed to a waveform record of EPICS base, over both protocols."""

import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from base_ioc_process import BaseIoc, small_ring

from orbitfb.app.commands.hand_over import HANDS_OVER, STOPPED, HandOver
from orbitfb.core.errors import MachineError
from orbitfb.core.names import PVA
from orbitfb.epics.fast_reference import FastFeedbackSettings
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.probe import Probe

pytestmark = pytest.mark.system

REFERENCE, FORBID = "SR:FOFB{Ref}X-SP", "TEST:FORBID"
RATE_HZ, STEP = 50.0, 20e-6
WANTED = np.linspace(-30e-6, 30e-6, 12)


def waveform(count: int = 12, kind: str = "DOUBLE", group: str = "DEFAULT") -> str:
    """A record of so many values in nm, and one that forbids to write to it (DISP)."""
    zeros = ", ".join(["0"] * count)
    return (
        f'record(waveform, "{REFERENCE}") {{ field(FTVL, "{kind}") field(NELM, "{count}") '
        f'field(EGU, "nm") field(ASG, "{group}") field(PINI, "YES") '
        f"field(INP, {{const:[{zeros}]}}) }}\n"
        f'record(ao, "{FORBID}") {{ field(OUT, "{REFERENCE}.DISP") }}'
    )


@contextmanager
def beside(ioc: BaseIoc, over: str) -> Iterator[tuple[EpicsMachine, HandOver]]:
    """A machine whose fast feedback is closed, and what hands our reference over."""
    fast = FastFeedbackSettings(reference_pvs={"x": over + REFERENCE})
    with EpicsMachine(small_ring(12), ioc.settings, fast=fast) as machine:
        reference = machine.fast_reference
        assert reference is not None
        none = lambda: ""  # noqa: E731
        yield machine, HandOver(reference, lambda: WANTED, none, none, STEP, 1e-8)


def steps(its: HandOver, count: int) -> None:
    for _ in range(count):
        time.sleep(0.05)  # a put and what is read back go one after the other
        its.step()


def put_by_hand(ioc: BaseIoc, pv: str, value: float) -> None:
    followed = small_ring(12).orbit_pvs[:1]
    with Probe(followed, pv, ioc.settings, lambda _: None) as probe:
        probe.turn(value)
        time.sleep(0.1)


@pytest.mark.parametrize("over", ["", PVA], ids=["channel-access", "pvaccess"])
def test_records_of_epics_base_take_the_reference_and_keep_what_others_set(over: str):
    if over:
        pytest.importorskip("p4p", reason="the extra `pva` is not installed")
    with (
        BaseIoc(small_ring(12), RATE_HZ, records=waveform(), pva=bool(over)) as ioc,
        beside(ioc, over) as (machine, its),
    ):
        reference = machine.fast_reference
        assert reference is not None
        its.begin()
        steps(its, 5)
        assert its.sight.state == HANDS_OVER and its.sight.reason == ""
        np.testing.assert_allclose(reference.ask(), WANTED, atol=1e-12)

        reference.put(WANTED + 5e-6)  # as somebody else would
        steps(its, 2)
        assert its.sight.state == STOPPED and "is not what was put" in its.sight.reason
        np.testing.assert_allclose(reference.ask(), WANTED + 5e-6, atol=1e-12)

        put_by_hand(ioc, FORBID, 1.0)  # the record takes no puts any more
        its.begin()
        steps(its, 3)
        assert its.sight.state == STOPPED
        np.testing.assert_allclose(reference.ask(), WANTED + 5e-6, atol=1e-12)

        put_by_hand(ioc, FORBID, 0.0)
        its.begin()
        ioc.kill()
        steps(its, 3)
        assert its.sight.state == HANDS_OVER and its.sight.reason


def test_records_that_cannot_take_it_are_told_before_anything_moves():
    bad = {
        "SHORT": (waveform(11), "holds 11 values"),
        "WHOLE": (waveform(kind="LONG"), "is an integer"),
        "CLOSED": (waveform(group="READONLY"), "may not be written"),
    }
    records = "\n".join(
        record.replace(REFERENCE, name).replace(FORBID, f"{name}:FORBID")
        for name, (record, _) in bad.items()
    )
    with BaseIoc(small_ring(12), RATE_HZ, records=records) as ioc:
        for name, (_, words) in bad.items():
            with pytest.raises(MachineError, match=words):
                EpicsMachine(
                    small_ring(12),
                    ioc.settings,
                    fast=FastFeedbackSettings(reference_pvs={"x": name}),
                )
