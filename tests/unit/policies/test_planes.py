"""A cut and a λ of each plane: the planes are solved by themselves, in config, law, mask, store."""

from pathlib import Path

import numpy as np
import pytest

from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Channels
from orbitfb.policies.blocks import PlaneLaw, sized
from orbitfb.policies.masking import MaskedPolicy, without
from orbitfb.policies.stability import growth_of
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

X, Y = (9, 5), (6, 4)
N, M = X[0] + Y[0], X[1] + Y[1]
RANDOM = np.random.default_rng(8)
COUPLED = 1e-3 * RANDOM.normal(size=(N, M))
COUPLED[: X[0], X[1] :] *= 0.05
COUPLED[X[0] :, : X[1]] *= 0.05
ERROR = 1e-5 * RANDOM.normal(size=N)
BPMS, CORRECTORS = tuple(f"B{k}" for k in range(N)), tuple(f"C{k}" for k in range(M))
CHANNELS = Channels(
    "xy", BPMS, CORRECTORS, BPMS, CORRECTORS, CORRECTORS, (X[0], Y[0]), (X[1], Y[1])
)
LAWS = {"x": PlaneLaw(singular_values=3), "y": PlaneLaw(regularisation=5e-4)}


def law(laws=LAWS, response=COUPLED, **chosen):
    settings = SvdSettings(gain=1.0, regularisation=1e-4, planes=sized(laws, CHANNELS), **chosen)
    return SvdPolicy(response, settings)


def alone(rows, columns, **chosen):
    return SvdPolicy(COUPLED[rows, columns], SvdSettings(**{"gain": 1.0, **chosen}))


X_PART = slice(0, X[0]), slice(0, X[1])
Y_PART = slice(X[0], N), slice(X[1], M)


@pytest.mark.parametrize("out", [(), (1, 12), tuple(range(X[0]))])
def test_each_plane_is_the_law_of_that_plane_alone(out):
    valid = np.ones(N, dtype=bool)
    valid[list(out)] = False
    policy = law()
    change, _ = policy.act(ERROR, valid, policy.initial_state())
    x = alone(*X_PART, singular_values=3, regularisation=1e-4)
    y = alone(*Y_PART, regularisation=5e-4)
    for part, own in ((X_PART, x), (Y_PART, y)):
        rows, columns = part
        wanted, _ = own.act(ERROR[rows], valid[rows], own.initial_state())
        np.testing.assert_allclose(change[columns], wanted, rtol=1e-9, atol=1e-12)


def test_without_laws_by_plane_the_whole_response_is_solved_under_its_old_name():
    plain = SvdPolicy(COUPLED, SvdSettings())
    assert plain.policy_id == "svd-8b253c19b804"
    coupling = plain.gain_matrix[: X[1], X[0] :]
    assert np.abs(coupling).max() > 1e-3 * np.abs(plain.gain_matrix).max()
    assert law().policy_id != plain.policy_id and not law().gain_matrix[: X[1], X[0] :].any()


def test_a_lost_corrector_is_made_up_for_within_its_plane():
    lost = np.arange(M) == 2
    masked = without(law({"x": PlaneLaw(), "y": PlaneLaw(regularisation=5e-4)}), lost)
    assert isinstance(masked, MaskedPolicy)
    change, _ = masked.act(ERROR, np.ones(N, dtype=bool), masked.initial_state())
    kept = np.flatnonzero(~lost[: X[1]])
    own = SvdPolicy(COUPLED[: X[0], kept], SvdSettings(gain=1.0, regularisation=1e-4))
    wanted, _ = own.act(ERROR[: X[0]], np.ones(X[0], dtype=bool), own.initial_state())
    assert change[2] == 0.0
    np.testing.assert_allclose(change[kept], wanted, rtol=1e-9)
    whole = law({"x": PlaneLaw(), "y": PlaneLaw(regularisation=5e-4)})
    same, _ = whole.act(ERROR, np.ones(N, dtype=bool), whole.initial_state())
    np.testing.assert_allclose(change[X[1] :], same[X[1] :], rtol=1e-12)


def test_whether_it_holds_is_asked_of_the_whole_response():
    assert growth_of(law()) <= 1.0001
    strong = COUPLED.copy()
    strong[: X[0], X[1] :] *= 400
    strong[X[0] :, : X[1]] *= 400
    assert growth_of(law({"x": PlaneLaw(), "y": PlaneLaw()}, strong)) > 1.0001


def test_it_is_stored_and_loaded_as_it_is(tmp_path: Path):
    policy = law()
    store = PolicyStore(tmp_path)
    store.save(policy, CHANNELS)
    loaded = store.load(policy.policy_id, CHANNELS)
    assert isinstance(loaded, SvdPolicy) and loaded.settings == policy.settings
    np.testing.assert_array_equal(loaded.gain_matrix, policy.gain_matrix)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match=r"singular_values is 5, but plane y .* has only 4"):
        law({"y": PlaneLaw(singular_values=5)})
    with pytest.raises(ConfigError, match="is for 0 BPMs and 0 correctors"):
        SvdPolicy(COUPLED, SvdSettings(planes={"x": PlaneLaw()}))


def test_the_configuration_takes_the_sizes_from_the_places(tmp_path: Path):
    file = tmp_path / "c.toml"
    file.write_text(
        "[ring]\nplanes = 'xy'\n[policy.svd.planes.y]\n"
        "singular_values = 40\nregularisation = 1e-4\n"
    )
    laws = load_config(file).policy.svd.planes
    assert {plane: (its.bpms, its.correctors) for plane, its in laws.items()} == {
        "x": (180, 180),
        "y": (180, 180),
    }
    assert (laws["x"].singular_values, laws["y"].singular_values) == (None, 40)
    file.write_text("[policy.svd.planes.y]\nsingular_values = 40\n")
    with pytest.raises(ConfigError, match=r"policy.svd.planes.y: the loop has x only"):
        load_config(file)
