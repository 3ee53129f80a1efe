"""One small ring and every policy on it: what the contract test runs over."""

import ast
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import orbitfb.policies
from orbitfb.core.ports import Policy
from orbitfb.policies.adaptive import AdaptivePolicy
from orbitfb.policies.adaptive_settings import AdaptiveSettings
from orbitfb.policies.embedding import embed
from orbitfb.policies.masking import MaskedPolicy
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings

BPMS, CORRECTORS = 12, 10


def make_response(seed=0):
    """A response with a decade and a half between its singular values [m/A]."""
    rng = np.random.default_rng(seed)
    left, _ = np.linalg.qr(rng.normal(size=(BPMS, CORRECTORS)))
    right, _ = np.linalg.qr(rng.normal(size=(CORRECTORS, CORRECTORS)))
    return left @ np.diag(np.geomspace(3e-2, 1e-3, CORRECTORS)) @ right.T


@dataclass(frozen=True)
class Example:
    """A policy of a class, made from a response.

    `exact` is how exactly its numbers can be expected to follow (single precision, bending).
    """

    name: str
    kind: str
    make: Callable[[np.ndarray], Policy]
    memoryless: bool = True
    exact: float = 1e-9


def _covariance():
    root = 2e-5 * np.random.default_rng(9).normal(size=(CORRECTORS, CORRECTORS))
    return root @ root.T


def _weights():
    return tuple(np.linspace(0.5, 2.0, BPMS).tolist())


def _svd(**chosen):
    return lambda response: SvdPolicy(response, SvdSettings(**chosen))


def _modal(**chosen):
    return lambda response: ModalPolicy(response, ModalSettings(**chosen), gains=0.2)


def _masked(make):
    movable = np.arange(CORRECTORS) != 3
    return lambda response: MaskedPolicy(make(response), response, movable)


def _adaptive(response):
    return AdaptivePolicy(response, AdaptiveSettings())


def _network(response):
    return embed(_modal()(response))


EXAMPLES = (
    Example("svd P", "SvdPolicy", _svd()),
    Example("svd PI", "SvdPolicy", _svd(integral_gain=0.1), memoryless=False),
    Example(
        "svd PID",
        "SvdPolicy",
        _svd(integral_gain=0.1, derivative_gain=0.1, derivative_filter=0.3),
        memoryless=False,
    ),
    Example(
        "svd cautious",
        "SvdPolicy",
        lambda response: SvdPolicy(response, SvdSettings(), covariance=_covariance()),
    ),
    Example("svd weighted", "SvdPolicy", _svd(bpm_weights=_weights())),
    Example("modal", "ModalPolicy", _modal()),
    Example("modal linear", "ModalPolicy", _modal(threshold=None)),
    Example("adaptive", "AdaptivePolicy", _adaptive, memoryless=False),
    Example("network", "NetworkPolicy", _network, exact=1e-4),
    Example("svd P, masked", "MaskedPolicy", _masked(_svd())),
    Example("svd weighted, masked", "MaskedPolicy", _masked(_svd(bpm_weights=_weights()))),
    Example("svd PID, masked", "MaskedPolicy", _masked(_svd(derivative_gain=0.1)), False),
    Example("modal, masked", "MaskedPolicy", _masked(_modal())),
    Example("adaptive, masked", "MaskedPolicy", _masked(_adaptive), memoryless=False),
    Example("network, masked", "MaskedPolicy", _masked(_network), exact=1e-4),
)


def policy_classes():
    """Names of all classes in `orbitfb.policies` that are policies, told from their text.

    A class with the methods `act` and `initial_state`, or one that inherits from such a class.
    """
    classes = [
        node
        for path in Path(orbitfb.policies.__path__[0]).glob("**/*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.ClassDef)
    ]
    found: set[str] = set()
    while True:
        more = {node.name for node in classes if _acts(node) or _bases(node) & found} - found
        if not more:
            return found
        found |= more


def _acts(node):
    methods = {item.name for item in node.body if isinstance(item, ast.FunctionDef)}
    return {"act", "initial_state"} <= methods and not _bases(node) & {"Protocol"}


def _bases(node):
    return {base.id for base in node.bases if isinstance(base, ast.Name)}
