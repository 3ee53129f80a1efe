"""Every machine keeps the same promises: in process, EPICS base, our own IOC."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from base_ioc_process import BaseIoc, as_arrays, small_ring
from machine_contract import CHECKS, Bench

from benchmarks.array_places import array_places
from orbitfb.core.clock import ManualClock
from orbitfb.core.names import PVA
from orbitfb.epics.machine import EpicsMachine
from orbitfb.epics.settings import PVA_SEARCH_PORT, EpicsSettings, PvaSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.sim.child import SimChild
from orbitfb.sim.job import SimJob
from orbitfb.sim.settings import SimSettings

pytestmark = pytest.mark.system

RATE_HZ = 20.0


def plant_bench(_: ExitStack) -> Bench:
    clock = ManualClock()
    plant = Plant(Ring.load(), "x", PlantSettings(), seed=1)
    return Bench(PlantMachine(plant, clock, 0.1), 0.1, clock.advance)


def base_bench(stack: ExitStack) -> Bench:
    ring = small_ring(12)
    ioc = stack.enter_context(BaseIoc(ring, RATE_HZ))
    machine = EpicsMachine(ring, EpicsSettings(server_port=ioc.port))
    stack.enter_context(machine)
    return Bench(machine, 1 / RATE_HZ, time.sleep)


def array_bench(stack: ExitStack) -> Bench:
    """Orbit, setpoints and readbacks are one waveform record each."""
    ring = as_arrays(small_ring(12))
    ioc = stack.enter_context(BaseIoc(ring, RATE_HZ))
    machine = EpicsMachine(ring, EpicsSettings(server_port=ioc.port))
    stack.enter_context(machine)
    return Bench(machine, 1 / RATE_HZ, time.sleep)


def pva_bench(stack: ExitStack) -> Bench:
    """The same records over pvAccess."""
    pytest.importorskip("p4p", reason="the extra `pva` is not installed")
    ring = as_arrays(small_ring(12), PVA)
    ioc = stack.enter_context(BaseIoc(ring, RATE_HZ))
    machine = stack.enter_context(EpicsMachine(ring, ioc.settings))
    return Bench(machine, 1 / RATE_HZ, time.sleep)


def sim_bench(stack: ExitStack) -> Bench:
    child = stack.enter_context(SimChild(SimJob(sim=SimSettings(rate_hz=RATE_HZ, port=0))))
    settings = EpicsSettings(server_port=child.port)
    machine = EpicsMachine(Ring.load().channels("x"), settings)
    stack.enter_context(machine)
    return Bench(machine, 1 / RATE_HZ, time.sleep)


def sim_array_bench(stack: ExitStack, over: str = "") -> Bench:
    """The same ring, three arrays instead of 540 scalars."""
    folder = stack.enter_context(TemporaryDirectory())
    places = array_places(Path(folder, "places.csv"), over)
    job = SimJob(places=places, sim=SimSettings(rate_hz=RATE_HZ, port=0, pva_port=0))
    child = stack.enter_context(SimChild(job))
    pva = PvaSettings(port=child.pva_port or PVA_SEARCH_PORT)
    settings = EpicsSettings(server_port=child.port, pva=pva)
    machine = EpicsMachine(Ring.load(places).channels("x"), settings)
    stack.enter_context(machine)
    return Bench(machine, 1 / RATE_HZ, time.sleep)


def sim_pva_bench(stack: ExitStack) -> Bench:
    """The same arrays over pvAccess."""
    pytest.importorskip("p4p", reason="the extra `pva` is not installed")
    return sim_array_bench(stack, PVA)


BENCHES = (
    plant_bench,
    base_bench,
    array_bench,
    pva_bench,
    sim_bench,
    sim_array_bench,
    sim_pva_bench,
)


@pytest.fixture(scope="module", params=BENCHES)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    build: Callable[[ExitStack], Bench] = request.param
    with ExitStack() as stack:
        yield build(stack)


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_contract(bench: Bench, check: Callable[[Bench], None]) -> None:
    check(bench)
