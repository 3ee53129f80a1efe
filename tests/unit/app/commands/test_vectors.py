"""The vectors of the panel: what the loop knows, plane by plane, in the units of the PVs."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orbitfb.app.commands.preview import Latest
from orbitfb.app.commands.vectors import Sources, Vectors, modes_of, still_vectors
from orbitfb.core.signals import LoopState, Orbit, Reading
from orbitfb.loop.adjustments import Adjustments
from orbitfb.loop.slot import PolicySlot
from orbitfb.panel.pv import Kind
from orbitfb.panel.pv_table import Extent, panel_pvs
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.svd import SvdPolicy, SvdSettings
from orbitfb.safety.bounds import Bounds

RING = Ring.load()
CHANNELS = RING.channels("xy")
RESPONSE = response(RING, "xy")
N, M = RESPONSE.shape
PVS = {pv.name: pv for pv in panel_pvs(PanelSettings(), Extent.of(CHANNELS))}


class Bench:
    def __init__(self) -> None:
        self.latest = Latest()
        self.wanted = Adjustments.none(np.full(N, 1e-5), M)
        self.movable = np.ones(M, dtype=bool)
        drive = np.full((M, 2), np.nan)
        drive[3] = -2.0, 1.0
        self.vectors = Vectors(
            Sources(
                CHANNELS,
                self.latest,
                PolicySlot(SvdPolicy(RESPONSE, SvdSettings(gain=0.5, regularisation=1e-4))),
                lambda: self.wanted,
                np.ones(N, dtype=bool),
                lambda: self.movable,
                lambda: Bounds.of(17.5, M, drive),
            )
        )

    def see(self, state: LoopState = LoopState.CLOSED) -> dict[str, Any]:
        valid = np.ones(N, dtype=bool)
        valid[2] = False
        position = 1e-6 * np.arange(N)
        position[2] = np.nan
        reading = Reading(Orbit(position, valid, 0.0), np.zeros(M), {}, 0.0)
        record = SimpleNamespace(
            reading=reading,
            reference=np.full(N, 1e-5),
            setpoints=np.linspace(-1, 1, M),
            requested=np.full(M, 0.02),
            applied=np.full(M, 0.01),
            state=state,
        )
        self.latest(cast(Any, record))
        return self.vectors.shown()


def test_each_is_in_the_table_of_pvs_and_as_long():
    shown, still = Bench().see(), still_vectors(RING, CHANNELS)
    vectors = {name for name, pv in PVS.items() if name[:-2].endswith(("X", "Y")) and pv.length > 1}
    by_hand = {"PreviewX-I", "PreviewY-I"}  # of a correction that is computed
    assert {*shown, *still} == vectors - by_hand
    for name, values in {**shown, **still}.items():
        assert len(values) == PVS[name].length, name


def test_orbit_reference_and_error_are_cut_into_planes_and_nan_where_not_used():
    bench = Bench()
    bench.wanted = replace(bench.wanted, enabled=np.arange(N) != N - 1)
    shown = bench.see()
    assert shown["OrbitX-I"][:4] == [0.0, 0.001, None, 0.003]
    assert shown["OrbitY-I"][0] == pytest.approx(0.18)
    assert shown["ErrorX-I"][5] == pytest.approx(-5.0) and shown["ErrorX-I"][2] is None
    assert shown["ErrorY-I"][-1] is None and shown["BpmUsedY-I"][-2:] == [1, 0]
    assert shown["BpmUsedX-I"][:4] == [1, 1, 0, 1]
    assert shown["ReferenceY-I"] == [0.01] * (N // 2)


def test_setpoints_and_changes_and_the_room_that_is_left():
    shown = Bench().see()
    assert shown["SetpointX-I"][0] == pytest.approx(-0.99)
    assert set(shown["ComputedX-I"]) == {0.02} and set(shown["AppliedY-I"]) == {0.01}
    assert shown["RoomX-I"][0] == pytest.approx(17.5 - 0.99)
    now = -1 + 3 * 2 / (M - 1) + 0.01
    assert shown["RoomX-I"][3] == pytest.approx(min(now + 2.0, 1.0 - now), abs=1e-4)


def test_the_change_of_a_shadow_is_shown_in_shadow_alone():
    assert set(Bench().see()["ShadowX-I"]) == {None}
    assert set(Bench().see(LoopState.SHADOW)["ShadowX-I"]) == {0.02}


def test_singular_values_and_the_part_of_each_mode_that_a_tick_corrects():
    bench = Bench()
    bench.wanted = replace(bench.wanted, gain=np.repeat([0.5, 1.0], M // 2))
    shown = bench.see()
    own = RESPONSE[N // 2 :, M // 2 :]
    sigma = np.linalg.svd(own)[1]
    np.testing.assert_allclose(shown["SingularValueY-I"], sigma, atol=1e-9)
    np.testing.assert_allclose(shown["ModeGainY-I"], 0.5 * sigma**2 / (sigma**2 + 1e-8), atol=1e-6)
    assert shown["ModeGainX-I"][0] == pytest.approx(0.25, abs=1e-3)


def test_a_law_without_matrices_has_no_modes():
    assert modes_of(cast(Any, SimpleNamespace(act=None)), CHANNELS) == {}
    [(sigma, part), _] = modes_of(cast(Any, SimpleNamespace(response=RESPONSE)), CHANNELS).values()
    assert part is None and sigma[0] > 0
    bench = Bench()
    bench.vectors._sources.slot.swap(cast(Any, SimpleNamespace(act=None)))
    assert bench.see()["SingularValueX-I"] is None


def test_names_and_positions_are_those_of_the_table():
    still = still_vectors(RING, CHANNELS)
    assert still["BpmNameY-I"] == RING.names("BPM")
    assert still["CorrectorNameX-I"][0] == "CH1A_C30" and still["CorrectorPositionX-I"][0] == 5.5325
    assert PVS["BpmNameX-I"].kind is Kind.NAMES
    assert PVS["ErrorX-I"].along == "BpmPositionX-I" in still
