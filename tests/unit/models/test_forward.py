"""The forward net: what naive training makes of a closed loop, and that validation sees it."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from orbitfb.core.errors import EstimationError, StoreError
from orbitfb.models.forward.files import load_forward, save_forward
from orbitfb.models.forward.fit import fit_forward
from orbitfb.models.forward.settings import ForwardSettings
from orbitfb.models.rows import Rows
from orbitfb.nets.checkpoint import Checkpoint

NOISE, GROUND, GAIN = 0.2e-6, 0.05e-6, 1.0
SETTINGS = ForwardSettings(
    hidden=(24,), members=2, window=64, iterations=300, batch=1024, belief=60.0, device="cpu"
)
PLAIN = SETTINGS.model_copy(update={"window": 1})


@pytest.fixture(autouse=True)
def one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def ring(n=10, m=8):
    return 1e-3 * np.random.default_rng(0).standard_normal((n, m))


def record(
    response, count, seed, gain=GAIN, dither=0.0, believed=None, bend=0.0, explore=0.0, law="law"
):
    """A loop a = −gain R̂⁺ y + dither, or random changes; `bend` adds a cubic answer."""
    generator = np.random.default_rng(seed)
    n, m = response.shape
    inverse = np.linalg.pinv(response if believed is None else believed)
    orbit = np.zeros(n)
    kept = {name: [] for name in ("orbit", "change", "dither")}
    for _ in range(count + 1):
        reading = orbit + NOISE * generator.standard_normal(n)
        noise = dither * generator.standard_normal(m)
        change = explore * generator.uniform(-1.0, 1.0, m)
        if not explore:
            change = noise - gain * (inverse @ reading)
        moved = response @ change
        orbit = orbit + moved + bend * moved**3 + GROUND * generator.standard_normal(n)
        for name, value in (("orbit", reading), ("change", change), ("dither", noise)):
            kept[name].append(value)
    orbits = np.array(kept["orbit"])
    return Rows(
        tick=np.arange(count),
        change=np.array(kept["change"])[:-1],
        dither=np.array(kept["dither"])[:-1],
        difference=np.diff(orbits, axis=0),
        valid=np.ones((count, n), dtype=bool),
        starts=np.arange(count) == 0,
        closed=np.full(count, not explore),
        left_out={},
        orbit=orbits[:-1],
        policy_id=np.full(count, law),
    )


def loop_gain(net, response):
    """Mean diagonal of the net's R̂ R⁺ over the modes that can be moved."""
    return float(np.trace(net.slope() @ np.linalg.pinv(response)) / response.shape[1])


@pytest.fixture(scope="module")
def honest():
    """A net fitted to innovations of a loop, validated on rows with a dither."""
    response = ring()
    rows = record(response, 3000, 1)
    return fit_forward(rows, record(response, 1500, 2, dither=3e-5), response, SETTINGS)


@pytest.fixture(scope="module")
def plain():
    """A net fitted to the changes of the orbit in the same loop."""
    response = ring()
    rows, other = record(response, 3000, 1), record(response, 1500, 2, dither=3e-5)
    return fit_forward(rows, other, response, PLAIN)


@pytest.mark.nightly
def test_plain_training_in_closed_loop_is_biased_and_the_validation_says_so(plain):
    """−RK tends to 1 + g/2 at the noise floor; here two inputs share it, s and a."""
    assert loop_gain(plain, ring()) > 1.2
    assert plain.figures["slope"] > 1.1
    assert plain.figures["validation_chi2"] > 1.1 * plain.figures["validation_chi2_response"]
    assert plain.figures["trusted"] == 0.0


@pytest.mark.nightly
def test_the_one_step_error_prefers_the_biased_net(honest, plain):
    """Why one-step errors decide nothing, not even on rows with a dither."""
    assert plain.figures["validation_r2"] > honest.figures["validation_r2"]


def test_training_on_innovations_is_not_biased(honest):
    assert loop_gain(honest, ring()) == pytest.approx(1.0, abs=0.05)
    assert honest.figures["slope"] == pytest.approx(1.0, abs=4 * honest.figures["slope_sigma"])
    assert honest.figures["trusted"] == 1.0
    assert honest.figures["other_share_training"] < 1e-6 < honest.figures["other_share"]


def test_refuses_rows_of_the_same_loop():
    response = ring()
    with pytest.raises(EstimationError, match=r"no other excitation.*dither"):
        fit_forward(record(response, 3000, 1), record(response, 1500, 2), response, SETTINGS)


def test_accepts_another_law_and_an_exploration():
    response = ring()
    rows = record(response, 1000, 1)
    short = SETTINGS.model_copy(update={"iterations": 2})
    for other in (record(response, 1000, 2, gain=0.3), record(response, 1000, 2, explore=1e-4)):
        figures = fit_forward(rows, other, response, short).figures
        assert figures["other_share"] > 0.1
        assert figures["slope"] == pytest.approx(1.0, abs=4 * figures["slope_sigma"])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows.take(0, 30), "record longer"),
        (lambda rows: replace(rows, orbit=None), "do not keep the orbit"),
        (lambda rows: replace(rows, change=0 * rows.change), "nothing was written"),
        (lambda rows: replace(rows, starts=np.arange(len(rows)) % 50 == 0), "longest unbroken"),
    ],
)
def test_says_what_is_missing(change, message):
    response = ring()
    other = record(response, 500, 2, dither=3e-5)
    with pytest.raises(EstimationError, match=message):
        fit_forward(change(record(response, 500, 1)), other, response, SETTINGS)


def test_a_wrong_first_response_is_corrected():
    response = ring()
    wrong = 1.25 * response
    rows = record(response, 3000, 1, believed=wrong, dither=2e-4)
    net = fit_forward(rows, record(response, 1500, 2, dither=2e-4), wrong, SETTINGS)
    assert loop_gain(net, response) == pytest.approx(1.0, abs=0.07)
    assert net.figures["slope_response"] > 1.1
    assert net.figures["validation_chi2"] < net.figures["validation_chi2_response"]


@pytest.mark.nightly
def test_learns_what_no_matrix_can_say_and_is_less_sure_where_it_has_not_been():
    """A cubic answer, explored in open loop: better than the best of all matrices."""
    response = 1e-3 * np.eye(4) + 1e-4 * np.random.default_rng(0).standard_normal((4, 4))
    bend = 3e10
    rows = record(response, 3000, 1, explore=3e-3, bend=bend)
    other = record(response, 1500, 2, explore=3e-3, bend=bend)
    settings = SETTINGS.model_copy(
        update={"hidden": (64,), "iterations": 1000, "learning_rate": 1e-2, "belief": 0.0}
    )
    net = fit_forward(rows, other, response, settings)
    assert net.figures["validation_chi2"] < 0.6 * net.figures["validation_chi2_response"]
    orbit, change = other.orbit, other.change
    moved = change @ response.T
    cubic = bend * moved**3
    matrix = np.linalg.lstsq(change, cubic, rcond=None)[0]
    missed = net.difference(orbit, change) - moved - cubic
    assert np.linalg.norm(missed) < 0.8 * np.linalg.norm(change @ matrix - cubic)
    near = np.sqrt(np.mean(net.uncertainty(orbit, change) ** 2))
    far = np.sqrt(np.mean(net.uncertainty(orbit, 5 * change) ** 2))
    assert far > 2 * near > 0.0


def test_the_forms_of_the_model_agree(honest):
    response = ring()
    rows = record(response, 300, 3)
    orbit, change = rows.orbit, rows.change
    predicted = honest.predict(orbit, change)
    np.testing.assert_allclose(honest.predict(orbit[5], change[5]), predicted[5], rtol=1e-9)
    step = honest.torch_step()
    tensors = [torch.tensor(array, dtype=torch.float32) for array in (orbit, change)]
    np.testing.assert_allclose(step(*tensors).numpy(), predicted, atol=1e-5 * NOISE, rtol=1e-4)
    unit = 1e-9
    slope = np.column_stack(
        [honest.predict(np.zeros(10), unit * column) / unit for column in np.eye(8)]
    )
    np.testing.assert_allclose(honest.slope(), slope, rtol=1e-5, atol=1e-9)
    assert not np.any(honest.predict(np.zeros(10), np.zeros(8)))


def test_gradients_reach_the_change(honest):
    change = torch.full((2, 8), 1e-8, requires_grad=True)
    honest.torch_step()(torch.zeros(2, 10), change).sum().backward()
    expected = honest.slope().sum(axis=0)
    np.testing.assert_allclose(change.grad[0].numpy(), expected, rtol=1e-3, atol=1e-6)


def test_the_same_seed_gives_the_same_net_and_a_resumed_training_too(tmp_path):
    response = ring()
    rows, other = record(response, 400, 1), record(response, 400, 2, dither=3e-5)
    settings = SETTINGS.model_copy(update={"iterations": 10})
    whole = fit_forward(rows, other, response, settings)

    def interrupt(done, _):
        if done == 6:
            raise KeyboardInterrupt

    def kept():
        return Checkpoint(tmp_path, {"what": "forward"})

    with pytest.raises(KeyboardInterrupt):
        fit_forward(rows, other, response, settings, checkpoint=kept(), every=3, progress=interrupt)
    resumed = fit_forward(rows, other, response, settings, checkpoint=kept(), every=3)
    assert resumed.curve == whole.curve
    for one, another in zip(whole.members, resumed.members, strict=True):
        for left, right in zip(one, another, strict=True):
            np.testing.assert_array_equal(left, right)


def test_comes_back_from_disk_and_damage_is_refused(honest, tmp_path):
    save_forward(honest, tmp_path)
    again = load_forward(tmp_path)
    rows = record(ring(), 50, 3)
    np.testing.assert_array_equal(
        again.predict(rows.orbit, rows.change), honest.predict(rows.orbit, rows.change)
    )
    assert dict(again.figures) == dict(honest.figures)
    tensors = next(tmp_path.glob("*.safetensors"))
    content = bytearray(tensors.read_bytes())
    content[-1] ^= 1
    tensors.write_bytes(content)
    with pytest.raises(StoreError, match="damaged"):
        load_forward(tmp_path)
    card = json.loads((tmp_path / "card.json").read_text())
    for key, value in (("tensors", "../x"), ("members", 3), ("bpms", 9), ("schema_version", 2)):
        save_forward(honest, tmp_path)
        (tmp_path / "card.json").write_text(json.dumps(card | {key: value}))
        with pytest.raises(StoreError):
            load_forward(tmp_path)
    with pytest.raises(StoreError, match="no forward net"):
        load_forward(tmp_path / "elsewhere")
