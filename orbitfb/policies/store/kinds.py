"""The kinds of policies that can be stored: their tensors, their settings, how they are made.

A new kind of this package is one more entry of `KINDS`; another package names its `Kind` as an
entry point of the group `orbitfb.policies`, under the word of the kind.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ConfigError, StoreError
from orbitfb.core.plugins import POLICIES, added
from orbitfb.core.ports import Policy
from orbitfb.core.settings import Settings
from orbitfb.estimation.recursive.settings import MOST_GROUPS
from orbitfb.policies.adaptive import AdaptivePolicy
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.network import LAYERS, NetworkPolicy, NetworkSettings, hidden_width
from orbitfb.policies.rf_known import COLUMN, ENERGY, rf_from, rf_tensors, with_rf
from orbitfb.policies.svd import SvdPolicy, SvdSettings

Tensors = Mapping[str, NDArray[Any]]
StoredPolicy = SvdPolicy | ModalPolicy | AdaptivePolicy | NetworkPolicy
"""What the store takes and gives."""

TAKEN = ("svd", "modal", "adaptive", "network", "supervised", "trajectory")
"""Words by which `policy.kind` knows what this package makes; some are stored as networks."""
_WIDEST = 4
"""How many times wider than the paper's a network may be."""


@dataclass(frozen=True, slots=True)
class Tensor:
    """What one tensor must look like.

    Args:
        dtype: Its numbers.
        shape: `n` BPMs, `m` correctors, `h` hidden units and `g` groups of modes (as many as the
            first one says).
        optional: Whether it may be absent.
    """

    dtype: type[np.floating[Any]]
    shape: str
    optional: bool = False


@dataclass(frozen=True, slots=True)
class Kind:
    """One class of policies.

    Args:
        word: What the card calls it.
        policy: The class.
        settings: Class of its settings.
        layout: Its tensors by name.
        take: Takes the tensors out of a policy.
        make: Makes a policy from tensors, settings and its name.
        begin: Makes a policy from a response R, shape (n, m) [m/A], and settings: how a kind of
            another package begins, and how it follows a refit. None: `learn.builders` knows how.
    """

    word: str
    policy: type[StoredPolicy]
    settings: type[Settings]
    layout: Mapping[str, Tensor]
    take: Callable[[Any], dict[str, NDArray[Any] | None]]
    make: Callable[[Tensors, Any, str], StoredPolicy]
    begin: Callable[[NDArray[np.float64], Any], StoredPolicy] | None = None

    def largest(self, n: int, m: int) -> int:
        """Bound the size of all tensors together [bytes].

        Args:
            n: BPMs.
            m: Correctors.
        """
        widths = {"n": n, "m": m, "h": _WIDEST * hidden_width(n), "g": MOST_GROUPS}
        return sum(
            np.dtype(tensor.dtype).itemsize * int(np.prod([widths[c] for c in tensor.shape]))
            for tensor in (*self.layout.values(), *_RF.values())
        )

    def take_all(self, policy: Any) -> dict[str, NDArray[Any]]:
        """Take the tensors out of a policy, and what it knows of the RF."""
        own = {name: tensor for name, tensor in self.take(policy).items() if tensor is not None}
        return own | rf_tensors(policy)

    def make_all(self, tensors: Tensors, settings: Any, name: str) -> StoredPolicy:
        """Make a policy that knows what it knew of the RF.

        Raises:
            OrbitFeedbackError: No policy can be made of them.
        """
        return with_rf(self.make(tensors, settings, name), rf_from(tensors))

    def mismatch(self, tensors: Tensors, n: int, m: int) -> str:
        """Say what is wrong with the names, types and shapes of tensors; "" when nothing is.

        Args:
            tensors: By name.
            n: BPMs.
            m: Correctors.
        """
        widths = {"n": n, "m": m}
        layout = {**self.layout, **_RF}
        for name, expected in layout.items():
            if name not in tensors:
                if expected.optional:
                    continue
                return f"no {name!r}"
            tensor = tensors[name]
            for letter, most in (("h", _WIDEST * hidden_width(n)), ("g", MOST_GROUPS)):
                known = letter in widths or letter not in expected.shape
                if not known and tensor.ndim == len(expected.shape):
                    widths[letter] = min(tensor.shape[expected.shape.index(letter)], most)
            shape = tuple(widths.get(letter, -1) for letter in expected.shape)
            if tensor.dtype != expected.dtype or tensor.shape != shape:
                return (
                    f"{name!r} of {tensor.dtype} {tensor.shape}, expected were "
                    f"{np.dtype(expected.dtype)} {shape}"
                )
        parts = [name for name in _RF if name in tensors]
        if 0 < len(parts) < len(_RF):
            return f"{parts[0]!r} without the rest of what is known of the RF"
        if not all(np.isfinite(tensors[name]).all() for name in parts):
            return f"{parts[0]!r} with numbers that are not finite"
        unknown = sorted(set(tensors) - set(layout))
        return (
            f"{unknown[0]!r}, which a policy of kind {self.word} does not have" if unknown else ""
        )


def _svd_tensors(policy: SvdPolicy) -> dict[str, NDArray[Any] | None]:
    return {"response": policy.response, "covariance": policy.covariance}


def _svd(tensors: Tensors, settings: SvdSettings, name: str) -> SvdPolicy:
    return SvdPolicy(tensors["response"], settings, name, tensors.get("covariance"))


def _modal_tensors(policy: ModalPolicy) -> dict[str, NDArray[Any] | None]:
    return {
        "response": policy.response,
        "modes": policy.modes,
        "gains": policy.gains,
        "thresholds": policy.thresholds,
        "covariance": policy.covariance,
    }


def _modal(tensors: Tensors, settings: ModalSettings, name: str) -> ModalPolicy:
    return ModalPolicy(
        tensors["response"],
        settings,
        tensors["modes"],
        tensors["gains"],
        tensors["thresholds"],
        tensors.get("covariance"),
        name,
    )


def _adaptive_tensors(policy: AdaptivePolicy) -> dict[str, NDArray[Any] | None]:
    known = policy.known  # once, for it may learn meanwhile
    size = known.response.shape[1]
    parts = known.covariances
    whole = None if parts is None else np.stack([part[:size, :size] for part in parts])
    return {"response": known.response, "covariances": whole}


def _adaptive(tensors: Tensors, settings: AdaptiveSettings, name: str) -> AdaptivePolicy:
    covariances = tensors.get("covariances")
    parts = None if covariances is None else tuple(covariances)
    return AdaptivePolicy(tensors["response"], settings, parts, name)


def _network_tensors(policy: NetworkPolicy) -> dict[str, NDArray[Any] | None]:
    weights = {f"weight_{number}": weight for number, weight in enumerate(policy.weights, 1)}
    return {"response": policy.response, **weights}


def _network(tensors: Tensors, settings: NetworkSettings, name: str) -> NetworkPolicy:
    weights = [tensors[f"weight_{number}"] for number in range(1, LAYERS + 1)]
    return NetworkPolicy(weights, tensors["response"], settings, name)


_RF = {
    COLUMN: Tensor(np.float64, "n", optional=True),
    ENERGY: Tensor(np.float64, "m", optional=True),
}
"""What every kind may know of the RF."""
_RESPONSE = {"response": Tensor(np.float64, "nm")}
_COVARIANCE = {"covariance": Tensor(np.float64, "mm", optional=True)}

KINDS = (
    Kind("svd", SvdPolicy, SvdSettings, _RESPONSE | _COVARIANCE, _svd_tensors, _svd),
    Kind(
        "modal",
        ModalPolicy,
        ModalSettings,
        _RESPONSE
        | {
            "modes": Tensor(np.float64, "nn"),
            "gains": Tensor(np.float64, "n"),
            "thresholds": Tensor(np.float64, "n"),
        }
        | _COVARIANCE,
        _modal_tensors,
        _modal,
    ),
    Kind(
        "adaptive",
        AdaptivePolicy,
        AdaptiveSettings,
        _RESPONSE | {"covariances": Tensor(np.float64, "gmm", optional=True)},
        _adaptive_tensors,
        _adaptive,
    ),
    Kind(
        "network",
        NetworkPolicy,
        NetworkSettings,
        _RESPONSE
        | {
            "weight_1": Tensor(np.float32, "hn"),
            "weight_2": Tensor(np.float32, "hh"),
            "weight_3": Tensor(np.float32, "hh"),
            "weight_4": Tensor(np.float32, "mh"),
        },
        _network_tensors,
        _network,
    ),
)


def kind_of(policy: Policy) -> tuple[Kind, StoredPolicy]:
    """Find the kind of a policy, that of the policy inside when correctors are masked.

    Returns:
        The kind, and the policy that is to be stored.

    Raises:
        StoreError: It is of none of them.
    """
    inside = policy
    while isinstance(inside, MaskedPolicy):
        inside = inside.policy
    kinds = all_kinds()
    for kind in kinds.values():
        if isinstance(inside, kind.policy):
            return kind, inside
    raise StoreError(
        f"a {type(inside).__name__} cannot be stored; policies of the kinds {', '.join(kinds)} can"
    )


def kind_named(word: str) -> Kind | None:
    """Find a kind by the word on a card; None: this version does not know it."""
    return all_kinds().get(word)


@cache
def added_kinds() -> Mapping[str, Kind]:
    """Kinds that other packages add, by their words.

    Raises:
        ConfigError: One cannot be loaded, or its word is taken or another than its entry point's.
    """
    kinds = added(POLICIES, Kind)
    for name, kind in kinds.items():
        where = f"entry point {name} ({POLICIES})"
        if kind.word != name:
            raise ConfigError(f"{where}: its kind is called {kind.word!r}; use one name for both")
        if name in TAKEN:
            raise ConfigError(f"{where}: there is a kind of policy {name} already")
        if kind.begin is None:
            raise ConfigError(f"{where}: its kind has no `begin`, so that no loop can run it")
    return kinds


@cache
def all_kinds() -> Mapping[str, Kind]:
    """All kinds by their words, those of other packages last."""
    return {**{kind.word: kind for kind in KINDS}, **added_kinds()}
