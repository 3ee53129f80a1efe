"""λ of each plane of the noise-aware law: in config, law, mask, training and store."""

from pathlib import Path

import numpy as np
import pytest

from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Channels
from orbitfb.policies.blocks import PlaneDamping, damped
from orbitfb.policies.inverse import regularised_inverse
from orbitfb.policies.masking import without
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.store.directory import PolicyStore

X, Y = (9, 5), (6, 4)
N, M = X[0] + Y[0], X[1] + Y[1]
RANDOM = np.random.default_rng(8)
RESPONSE = np.zeros((N, M))
RESPONSE[: X[0], : X[1]] = 1e-3 * RANDOM.normal(size=X)
RESPONSE[X[0] :, X[1] :] = 1e-3 * RANDOM.normal(size=Y)
DOUBT = 1e-9 * np.eye(M)
BPMS, CORRECTORS = tuple(f"B{k}" for k in range(N)), tuple(f"C{k}" for k in range(M))
CHANNELS = Channels(
    "xy", BPMS, CORRECTORS, BPMS, CORRECTORS, CORRECTORS, (X[0], Y[0]), (X[1], Y[1])
)
SETTINGS = ModalSettings(
    regularisation=1e-4,
    near_caution=0.25,
    planes=damped({"y": PlaneDamping(regularisation=8e-4)}, 1e-4, CHANNELS),
)


@pytest.mark.parametrize("covariance", [None, DOUBT])
def test_each_plane_is_damped_as_that_plane_alone(covariance):
    law = ModalPolicy(RESPONSE, SETTINGS, gains=0.5, covariance=covariance)
    share = np.sqrt(SETTINGS.near_caution)
    for rows, columns, own in (
        (slice(0, X[0]), slice(0, X[1]), 1e-4),
        (slice(X[0], N), slice(X[1], M), 8e-4),
    ):
        part = RESPONSE[rows, columns]
        # n P of the whole has all n rows.
        doubt = None if covariance is None else covariance[columns, columns] * N / len(part)
        for matrix, scale in ((law.inverse, 1.0), (law.near_inverse, share)):
            its = None if doubt is None else scale**2 * doubt
            wanted = regularised_inverse(part, scale * own, its)
            np.testing.assert_allclose(matrix[columns, rows], wanted, rtol=1e-8, atol=1e-9)


def test_one_damping_for_all_is_the_law_under_its_old_name():
    # Modes and gains are given: found ones differ in their last digit from processor to processor.
    given = {"modes": np.eye(N), "gains": 0.5, "thresholds": 1e-6}
    plain = ModalPolicy(RESPONSE, ModalSettings(regularisation=1e-4), **given)
    same = regularised_inverse(RESPONSE, np.full(M, 1e-4))
    np.testing.assert_array_equal(plain.inverse, same)
    assert plain.policy_id == "modal-dc1b241e56b9"
    assert ModalPolicy(RESPONSE, SETTINGS, **given).policy_id != plain.policy_id


def test_a_plane_without_damping_may_lack_rank():
    response = RESPONSE.copy()
    response[:, 1] = response[:, 0]
    planes = damped({"x": PlaneDamping(regularisation=0.0)}, 1e-4, CHANNELS)
    law = ModalPolicy(response, ModalSettings(planes=planes))
    assert np.abs(law.inverse).max() < 1e5
    np.testing.assert_allclose(law.inverse[0], law.inverse[1], rtol=1e-6)


def test_a_lost_corrector_is_made_up_for_with_the_damping_of_its_plane():
    lost = np.arange(M) == 2
    masked = without(ModalPolicy(RESPONSE, SETTINGS, gains=1.0, thresholds=np.inf), lost)
    change, _ = masked.act(1e-5 * np.ones(N), np.ones(N, dtype=bool), masked.initial_state())
    kept = np.flatnonzero(~lost[: X[1]])
    settings = SETTINGS.model_copy(update={"planes": {}})
    own = ModalPolicy(RESPONSE[: X[0], kept], settings, gains=1.0, thresholds=np.inf)
    wanted, _ = own.act(1e-5 * np.ones(X[0]), np.ones(X[0], dtype=bool), None)
    np.testing.assert_allclose(change[kept], wanted, rtol=0.02)
    assert change[2] == 0.0


def test_it_is_stored_and_loaded_as_it_is(tmp_path: Path):
    law = ModalPolicy(RESPONSE, SETTINGS)
    store = PolicyStore(tmp_path)
    store.save(law, CHANNELS)
    loaded = store.load(law.policy_id, CHANNELS)
    assert isinstance(loaded, ModalPolicy) and loaded.settings == SETTINGS
    np.testing.assert_array_equal(loaded.gain_matrix, law.gain_matrix)


def test_the_configuration_takes_the_sizes_from_the_places(tmp_path: Path):
    file = tmp_path / "c.toml"
    file.write_text(
        "[ring]\nplanes = 'xy'\n[policy.modal]\nregularisation = 2e-5\n"
        "[policy.modal.planes.y]\nregularisation = 1e-4\n"
    )
    planes = load_config(file).policy.modal.planes
    assert {its: (planes[its].regularisation, planes[its].correctors) for its in planes} == {
        "x": (2e-5, 180),
        "y": (1e-4, 180),
    }


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "[policy.modal.planes.y]\nregularisation = 1e-4\n",
            "policy.modal.planes.y: the loop has x",
        ),
        ("[policy.modal.planes.x]\nregularisation = -1\n", "greater than or equal to 0"),
        ("[policy.modal.planes.x]\nsingular_values = 4\n", "singular_values"),
    ],
)
def test_what_does_not_fit_is_refused(tmp_path: Path, text, words):
    file = tmp_path / "c.toml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=words):
        load_config(file)


def test_a_law_of_another_ring_is_refused():
    with pytest.raises(ConfigError, match="is for 9 correctors, but the response matrix has 5"):
        ModalPolicy(RESPONSE[:, :5], SETTINGS)
