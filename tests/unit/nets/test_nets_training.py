"""Training: the same numbers by seed, interrupted or not, and a clear word when it diverges."""

import json
import signal

import numpy as np
import pytest
import torch

from orbitfb.core.errors import ConfigError, StoreError, TrainingError
from orbitfb.nets.checkpoint import Checkpoint
from orbitfb.nets.device import pick_device
from orbitfb.nets.perceptron import Perceptron
from orbitfb.nets.training import train


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def clone_of_a_matrix(seed=0):
    """A network that learns a random matrix from random states: a whole small training."""
    network = Perceptron([6, 17, 17, 5], seed=seed)
    generator = torch.Generator().manual_seed(seed)
    matrix = torch.randn(6, 5, generator=torch.Generator().manual_seed(99))

    def loss_at(iteration):
        states = torch.randn(16, 6, generator=generator)
        return torch.mean((network(states) - states @ matrix) ** 2)

    return network, generator, loss_at


def run(iterations, checkpoint=None, progress=None, **options):
    network, generator, loss_at = clone_of_a_matrix()
    curve = train(
        {"policy": network},
        loss_at,
        iterations=iterations,
        learning_rate=options.pop("learning_rate", 3e-3),
        generator=generator,
        progress=progress,
        checkpoint=checkpoint,
        **options,
    )
    return network, curve


def assert_same(one, other):
    for left, right in zip(one.arrays(), other.arrays(), strict=True):
        np.testing.assert_array_equal(left, right)


def test_the_network_is_its_formula():
    network = Perceptron([4, 7, 6, 3], seed=1, output_scale=0.05)
    first, second, last = (array.astype(float) for array in network.arrays())
    x = np.random.default_rng(0).normal(size=(5, 4))
    expected = np.tanh(np.tanh(x @ first.T) @ second.T) @ last.T
    with torch.no_grad():
        result = network(torch.from_numpy(x.astype(np.float32))).numpy()
    np.testing.assert_allclose(result, expected, rtol=1e-5, atol=1e-7)
    assert not network(torch.zeros(4)).any()


def test_weights_follow_the_seed_alone():
    torch.manual_seed(5)
    one = Perceptron([4, 7, 3], seed=1)
    torch.manual_seed(6)
    assert_same(one, Perceptron([4, 7, 3], seed=1))
    other = Perceptron([4, 7, 3], seed=2)
    assert not np.array_equal(one.arrays()[0], other.arrays()[0])
    assert np.abs(one.arrays()[0]).max() <= 0.5


def test_matrices_go_out_and_in_again():
    network = Perceptron([4, 7, 3], seed=1, output_scale=0.25)
    copy = Perceptron([4, 7, 3], seed=2, output_scale=0.25)
    copy.load_arrays(network.arrays())
    assert_same(network, copy)
    with pytest.raises(ConfigError, match="needs"):
        Perceptron([4, 8, 3], seed=1).load_arrays(network.arrays())


@pytest.mark.parametrize(("sizes", "scale"), [([4], 1.0), ([4, 0, 2], 1.0), ([4, 2], 0.0)])
def test_what_is_no_network_is_refused(sizes, scale):
    with pytest.raises(ConfigError):
        Perceptron(sizes, seed=0, output_scale=scale)


def test_training_learns_and_tells():
    told = []
    _, curve = run(400, progress=lambda done, loss: told.append((done, loss)))
    assert np.mean(curve[-20:]) < 0.2 * np.mean(curve[:20])
    assert told == list(zip(range(1, 401), curve, strict=True))


def test_the_same_seed_gives_the_same_training():
    one, first = run(30)
    other, second = run(30)
    assert first == second
    assert_same(one, other)


def test_an_interrupted_training_goes_on_bit_for_bit(tmp_path):
    whole, curve = run(60, clip=1.0)

    def interrupt(done, _loss):
        if done == 23:
            signal.raise_signal(signal.SIGINT)

    checkpoint = Checkpoint(tmp_path, {"seed": 0})
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        run(60, checkpoint, interrupt, clip=1.0, checkpoint_every=10)
    assert signal.getsignal(signal.SIGINT) is handler
    told = []
    resumed, continued = run(
        60, Checkpoint(tmp_path, {"seed": 0}), lambda done, _: told.append(done), clip=1.0
    )
    assert told[0] == 24
    assert continued == curve
    assert_same(resumed, whole)


def test_a_killed_training_goes_on_from_its_last_checkpoint(tmp_path):
    whole, curve = run(40)

    def die(done, _loss):
        if done == 33:
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError):
        run(40, Checkpoint(tmp_path), die, checkpoint_every=10)
    assert json.loads((tmp_path / "card.json").read_text())["step"] == 30
    assert len(list(tmp_path.iterdir())) == 2
    resumed, continued = run(40, Checkpoint(tmp_path))
    assert continued == curve
    assert_same(resumed, whole)


def test_a_rate_can_follow_the_iteration():
    network, _ = run(5, learning_rate=lambda iteration: 0.0)
    assert_same(network, Perceptron([6, 17, 17, 5], seed=0))


def test_the_gradient_is_limited():
    """With a limit far below the gradient's norm, Adam sees gradients of exactly that norm."""
    network, generator, loss_at = clone_of_a_matrix()
    train(
        {"policy": network},
        loss_at,
        iterations=1,
        learning_rate=1e-3,
        generator=generator,
        clip=1e-3,
    )
    norm = np.sqrt(sum(float((p.grad**2).sum()) for p in network.parameters()))
    assert norm == pytest.approx(1e-3, rel=1e-4)


def test_a_loss_that_is_no_number_is_named_with_its_iteration(tmp_path):
    network = Perceptron([3, 4, 2], seed=0)
    before = []

    def loss_at(iteration):
        if iteration == 7:
            before.extend(network.arrays())
        return network(torch.ones(3)).sum() * (np.nan if iteration == 7 else 1.0)

    with pytest.raises(TrainingError, match=r"iteration 7 .*learning rate \(0\.01\)"):
        train(
            {"policy": network},
            loss_at,
            iterations=20,
            learning_rate=1e-2,
            generator=torch.Generator(),
            checkpoint=Checkpoint(tmp_path),
            checkpoint_every=5,
        )
    for kept, now in zip(before, network.arrays(), strict=True):
        np.testing.assert_array_equal(kept, now)
    assert json.loads((tmp_path / "card.json").read_text())["step"] == 5


def test_a_gradient_that_is_no_number_is_named():
    network = Perceptron([3, 4, 2], seed=0)

    def loss_at(_iteration):
        return torch.sqrt(0.0 * network(torch.ones(3)).sum())

    with pytest.raises(TrainingError, match="gradient is not finite at iteration 0"):
        train(
            {"policy": network},
            loss_at,
            iterations=2,
            learning_rate=1e-2,
            generator=torch.Generator(),
        )


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    run(5, Checkpoint(tmp_path, {"seed": 0, "rate": 1}))
    with pytest.raises(StoreError, match="rate differ"):
        run(5, Checkpoint(tmp_path, {"seed": 0, "rate": 2}))
    network = Perceptron([6, 18, 17, 5], seed=0)
    with pytest.raises(StoreError, match="another network"):
        train(
            {"policy": network},
            lambda _: network(torch.ones(6)).sum(),
            iterations=9,
            learning_rate=1e-3,
            generator=torch.Generator(),
            checkpoint=Checkpoint(tmp_path, {"seed": 0, "rate": 1}),
        )


@pytest.mark.parametrize("damage", ["flip", "cut", "missing", "card", "elsewhere"])
def test_a_damaged_checkpoint_is_refused(tmp_path, damage):
    run(5, Checkpoint(tmp_path))
    card = tmp_path / "card.json"
    (tensors,) = tmp_path.glob("state-*.safetensors")
    content = bytearray(tensors.read_bytes())
    if damage == "flip":
        content[-3] ^= 1
        tensors.write_bytes(content)
    elif damage == "cut":
        tensors.write_bytes(content[:-8])
    elif damage == "missing":
        tensors.unlink()
    elif damage == "card":
        card.write_text(card.read_text()[:-5])
    else:
        entries = json.loads(card.read_text())
        card.write_text(json.dumps(entries | {"tensors": "../" + entries["tensors"]}))
    with pytest.raises(StoreError, match="remove"):
        run(9, Checkpoint(tmp_path))


def test_a_removed_checkpoint_leaves_nothing(tmp_path):
    checkpoint = Checkpoint(tmp_path)
    run(5, checkpoint)
    assert checkpoint.exists()
    checkpoint.remove()
    assert not checkpoint.exists()
    assert not list(tmp_path.iterdir())


def test_devices_are_picked_by_name(monkeypatch):
    assert pick_device("cpu").type == "cpu"
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert pick_device("auto").type == "cpu"
    with pytest.raises(ConfigError, match="no GPU"):
        pick_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert pick_device("auto").type == "cuda"
    with pytest.raises(ConfigError, match="auto, cpu or cuda"):
        pick_device("tpu")
