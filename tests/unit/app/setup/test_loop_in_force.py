"""The loop that a measured response is judged by: that in force, or that of the configuration."""

from pathlib import Path

import numpy as np
import pytest

from orbitfb.app.commands.known_response import KnownResponse
from orbitfb.app.setup.loop_in_force import loop_of
from orbitfb.config.tree import AppConfig
from orbitfb.loco.growth import growths
from orbitfb.loco.measured import Measured
from orbitfb.measure.column import Table
from orbitfb.measure.growth import growth_by_plane, growth_told
from orbitfb.measure.response_file import MeasuredResponse
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.policies.stability import growth_on
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

RING = Ring.load()
CHANNELS = RING.channels("x")
OPTICS = response(RING, "x")


def config(data: Path, **policy: object) -> AppConfig:
    return AppConfig.model_validate({"data_directory": data, "policy": policy})


def reversed_bpm() -> np.ndarray:
    matrix = OPTICS.copy()
    matrix[7] *= -1.0
    return matrix


def test_the_configured_gain_counts_and_not_the_default_one(tmp_path: Path) -> None:
    strong = loop_of(config(tmp_path, svd={"gain": 1.5}), RING)
    assert strong.name == "the configured SVD loop on the optics"
    larger = 1.5 * OPTICS  # a gain of 0.5 holds there, one of 1.5 does not
    assert growth_by_plane(larger, OPTICS, CHANNELS, None)["x"] <= 1.0001
    assert growth_by_plane(larger, OPTICS, CHANNELS, strong)["x"] == pytest.approx(1.25, abs=0.01)
    told = growth_told(larger, OPTICS, CHANNELS, strong)["x"]
    assert told.startswith("the configured SVD loop on the optics would lose the beam")


def test_the_policy_in_force_counts_and_not_the_configured_one(tmp_path: Path) -> None:
    policy = SvdPolicy(reversed_bpm(), SvdSettings(gain=0.4))
    store = PolicyStore(tmp_path / "policies")
    store.save(policy, CHANNELS)
    store.activate(policy.policy_id)
    loop = loop_of(config(tmp_path), RING)
    assert loop.name == f"policy {policy.policy_id}, which is in force,"
    assert growth_by_plane(reversed_bpm(), OPTICS, CHANNELS, loop)["x"] <= 1.0001
    assert growth_by_plane(OPTICS, OPTICS, CHANNELS, loop)["x"] > 1.01


def test_a_trained_kind_is_stood_in_for_by_the_svd(tmp_path: Path) -> None:
    loop = loop_of(config(tmp_path, kind="supervised"), RING)
    assert loop.name == "the configured SVD loop on the optics"


def test_a_configured_response_that_cannot_be_used_is_no_obstacle(tmp_path: Path) -> None:
    (tmp_path / "broken.safetensors").write_bytes(b"no matrix")
    chosen = AppConfig.model_validate(
        {"data_directory": tmp_path, "ring": {"response": tmp_path / "broken.safetensors"}}
    )
    assert loop_of(chosen, RING).name == "the configured SVD loop on the optics"


def test_what_was_not_measured_is_as_the_optics_say(tmp_path: Path) -> None:
    loop = loop_of(config(tmp_path), RING)
    part = reversed_bpm()
    part[:, 90:] = np.nan
    whole = np.where(np.isfinite(part), part, OPTICS)
    found = growth_by_plane(part, OPTICS, CHANNELS, loop)["x"]
    assert found == pytest.approx(growth_on(loop.policy, whole))
    assert growth_by_plane(np.full_like(part, np.nan), OPTICS, CHANNELS, loop) == {}


def test_one_plane_of_a_policy_of_both_is_that_plane() -> None:
    channels, both = RING.channels("xy"), response(RING, "xy")
    policy = SvdPolicy(both, SvdSettings())
    rows, columns = channels.bpm_parts["y"], channels.corrector_parts["y"]
    own = SvdPolicy(both[rows, columns], SvdSettings())
    measured = 0.7 * both[rows, columns]
    found = growth_on(policy, measured, (rows, columns))
    assert found == pytest.approx(growth_on(own, measured), abs=0.01)


def test_a_diagnosis_asks_the_same_loop_of_the_devices_that_were_measured(tmp_path: Path) -> None:
    loop = loop_of(config(tmp_path, svd={"gain": 1.5}), RING)
    bpms, correctors = RING.places("BPM")[::2], RING.places("COR")[1::2]
    part = 2.0 * OPTICS[::2, 1::2] / RING.table.calibration[0, correctors]
    measured = Measured(
        {"x": bpms}, {"x": correctors}, {("x", "x"): part}, {("x", "x"): np.full_like(part, np.nan)}
    )
    whole = OPTICS.copy()
    whole[::2, 1::2] *= 2.0
    found = growths(RING, measured, {"x": part / 2.0}, loop, "x")
    assert found[0].per_tick == pytest.approx(growth_on(loop.policy, whole))
    assert "the configured SVD loop" in found[0].text
    of_table = growths(RING, measured, {"x": part / 2.0})
    assert "an SVD loop on the optics" in of_table[0].text


def test_a_service_knows_what_it_measured_zero_where_masked() -> None:
    table = Table.empty(*OPTICS.shape)
    table.response[:] = reversed_bpm()
    table.response[:, 3] = np.nan
    counting, moving = np.ones(len(OPTICS), bool), np.ones(OPTICS.shape[1], bool)
    counting[20] = moving[30] = False
    known = KnownResponse()
    known.take(MeasuredResponse(table, np.zeros(OPTICS.shape[1]), {}), OPTICS, counting, moving)
    matrix = known.matrix
    assert matrix is not None
    assert np.array_equal(matrix[:20, 3], OPTICS[:20, 3])
    assert not matrix[20].any() and not matrix[:, 30].any()
    assert np.array_equal(matrix[7, :3], -OPTICS[7, :3])
