"""Devices of one plane, and H and V at one s: physics, loop, masks, files, names."""

from dataclasses import replace

import numpy as np
import pytest
from single_planes import PAIRED, X_ONLY, write_ring

from orbitfb.app.commands.autosave import all_but, labels, names_off
from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import RingError
from orbitfb.core.signals import Channels, LoopState
from orbitfb.effects.build import layout_of
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.panel.pv_table import Extent
from orbitfb.physics.bump import closed_bump, find_source
from orbitfb.physics.frequency import frequency_model
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant
from orbitfb.physics.plant_machine import PlantMachine
from orbitfb.physics.response import response
from orbitfb.policies.masking import MaskSettings, mask_of
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.bpms import bpm_quota
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.sim.pv_table import count_pvs, pv_families
from orbitfb.sim.settings import SimSettings

N, M = (180, 179), (90, 105)


@pytest.fixture(scope="module")
def ring(tmp_path_factory: pytest.TempPathFactory) -> Ring:
    return Ring.load(*write_ring(tmp_path_factory.mktemp("ring")))


@pytest.fixture(scope="module")
def channels(ring: Ring) -> Channels:
    return ring.channels("xy")


def test_each_plane_has_its_own_devices(ring: Ring, channels: Channels):
    assert (channels.bpm_counts, channels.corrector_counts) == (N, M)
    assert X_ONLY in channels.bpms[: N[0]] and X_ONLY not in channels.bpms[N[0] :]
    names = channels.correctors
    assert all(its.endswith("H") for its in names[: M[0]] if its.startswith(PAIRED))
    assert all(its.endswith("V") for its in names[M[0] :] if its.startswith(PAIRED))
    assert len({*names}) == sum(M) and all(channels.setpoint_pvs)
    both = channels.bpm_planes, channels.corrector_planes
    assert [planes.count("y") for planes in both] == [N[1], M[1]]
    assert ring.channels("y").bpm_counts == ()


def test_the_response_is_that_of_the_whole_ring_at_these_devices(ring: Ring, channels: Channels):
    whole, matrix = Ring.load(), response(ring, "xy")
    assert matrix.shape == (sum(N), sum(M))
    for plane in ("x", "y"):
        all_of = whole.channels(plane)
        rows, columns = channels.bpm_parts[plane], channels.corrector_parts[plane]
        name = [its.removesuffix("H").removesuffix("V") for its in channels.correctors[columns]]
        there = np.ix_(
            [all_of.bpms.index(its) for its in channels.bpms[rows]],
            [all_of.correctors.index(its) for its in name],
        )
        np.testing.assert_array_equal(matrix[rows, columns], response(whole, plane)[there])
    assert not matrix[: N[0], M[0] :].any() and not matrix[N[0] :, : M[0]].any()
    model = frequency_model(ring, "xy")
    assert model.response.shape == (sum(N),) and not model.response[N[0] :].any()
    assert model.energy.shape == (sum(M),) and not model.energy[M[0] :].any()


def test_a_loop_of_both_planes_corrects_both(ring: Ring):
    clock = ManualClock()
    machine = PlantMachine(Plant(ring, "xy", seed=1), clock)
    runner = Runner(
        machine,
        PolicySlot(SvdPolicy(response(ring, "xy"), SvdSettings())),
        LoopSettings(),
        LimitSettings(),
        InterlockSettings(),
        np.zeros(sum(N)),
        clock,
        start=LoopState.CLOSED,
        random=np.random.default_rng(1),
    )
    for _ in range(150):
        record = runner.step()
    assert record.state is LoopState.CLOSED and record.reading is not None
    for part in machine.channels.bpm_parts.values():
        assert np.sqrt(np.mean(record.reading.orbit.position[part] ** 2)) < 5e-6


def test_masks_labels_and_quotas_know_the_planes(channels: Channels):
    pair = f"{PAIRED}_C10H", f"{PAIRED}_C10V"
    counting, moving = mask_of(channels, MaskSettings(bpms=(f"{X_ONLY}:x",), correctors=pair))
    assert np.flatnonzero(~counting).tolist() == [channels.bpms.index(X_ONLY)]
    assert [channels.correctors[j] for j in np.flatnonzero(~moving)] == [*pair]
    own = labels(channels.bpms, channels.bpm_planes)
    assert len({*own}) == sum(N) and own[N[0] - 1].endswith(":x") and own[N[0]].endswith(":y")
    enabled = np.arange(sum(M)) != M[0]  # the first of y
    off = names_off(channels.correctors, channels.corrector_planes, enabled)
    np.testing.assert_array_equal(
        all_but(channels.correctors, channels.corrector_planes, off), enabled
    )
    valid = np.ones(sum(N), dtype=bool)
    valid[[N[0] - 2, N[0] - 1, N[0], N[0] + 1]] = False  # two and two, not four in a row
    parts = tuple(channels.bpm_parts.values())
    settings = InterlockSettings(max_invalid_bpms=5, max_adjacent_bpms=2)
    assert bpm_quota(valid, settings, planes=parts).may_act
    assert not bpm_quota(valid, settings, planes=1).may_act


def test_bumps_effects_panel_and_simulator_have_the_devices_of_each_plane(
    ring: Ring, channels: Channels
):
    bump = closed_bump(ring, "y", find_source(ring, "PL1B_C30,PL1A_C01"), 1e-4)
    assert (len(bump.orbit), len(bump.kicks)) == (N[1], M[1])
    layout = layout_of(ring, "xy", 0.1)
    assert layout.bpms.names == channels.bpms and layout.correctors.names == channels.correctors
    assert tuple(layout.bpms.planes) == channels.bpm_planes
    assert Extent.of(channels).lengths() == {"x": (N[0], M[0]), "y": (N[1], M[1])}
    families = pv_families(ring, "xy", SimSettings())
    sizes = {its.meaning: len(its.specs) for its in families}
    assert sizes["BPM reading, y"] == N[1] and sizes["corrector setpoint, x"] == M[0]
    assert sizes["corrector readback, y"] == M[1]
    assert count_pvs(families) > sum(N) + 2 * sum(M)


def test_a_plane_without_devices_is_refused(ring: Ring):
    table = ring.table
    pv = tuple(
        "" if kind == "BPM" else its for kind, its in zip(table.kind, table.pv[1], strict=True)
    )
    blind = replace(ring, table=replace(table, pv=(table.pv[0], pv)))
    with pytest.raises(RingError, match="no place of kind BPM is in plane y"):
        blind.channels("xy")
    assert len(blind.channels("x").bpms) == N[0]
