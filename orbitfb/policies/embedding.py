"""The modal law, written into the weights of the paper's network: nothing is trained.

    a = −K U f(Uᵀ e),     f_i(z) = z − (1 − L_i) δ_i tanh(z / δ_i)

2n of the h hidden units carry it. In the first layer unit i is x_i = tanh(α z_i / s), in the
linear range, and unit n + i is tanh(z_i / δ_i). The second and third layer hand both on, the
latter made small (α) so that it is not bent again, and the last matrix puts them together:
column i is −K U_i s / α, column n + i is (K − K_near L_i) U_i δ_i / α; in a mode without a
threshold they are −K_near L_i U_i s / α and 0.

What is lost: three tanh of x differ from x by a relative x², that is (α z/s)²: for α = 10⁻⁴ and
s = 250 µm 10⁻⁸ of a mode's amplitude at 250 µm and 2 · 10⁻⁵ at 10 mm; and single precision
(see `policies.network`), which is relative, so that a small α costs nothing at the noise floor.
Measured on the default ring, change by change and relative to the law: 2 · 10⁻⁵ at 0.05 µm,
where the two columns of a mode nearly cancel, below 10⁻⁶ from 1 µm to 1 mm. A larger α bends
more (0.02: 1.5 · 10⁻³ at 250 µm, 2.5 · 10⁻² at 1 mm) and gains nothing here; it is for networks
that are to be trained on, whose last matrix would otherwise be large.

Only the last matrix holds K and the gains: a new response or new gains in the same modes, with
the same thresholds, leave the hidden layers as they are.
"""

import numpy as np
from numpy.typing import NDArray

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.policies.modal import ModalPolicy
from orbitfb.policies.network import NetworkPolicy, NetworkSettings, Weights, hidden_width

LINEAR_RANGE = 1e-4
"""The default α: what a unit of the linear range sees at the input scale [1]."""


def embed(
    law: ModalPolicy,
    settings: NetworkSettings | None = None,
    linear_range: float = LINEAR_RANGE,
    policy_id: str | None = None,
) -> NetworkPolicy:
    """Write a modal law into a network of the paper's shape.

    Args:
        law: The law.
        settings: The network's input scale s.
        linear_range: α, above 0 and at most 0.3 [1].
        policy_id: Name of the network; by default from its content.

    Returns:
        The network, equal to the law within the bounds above.

    Raises:
        ConfigError: α is out of its range.
    """
    if not 0.0 < linear_range <= 0.3:
        raise ConfigError(f"linear_range is {linear_range:g}; it must lie above 0, at most 0.3")
    settings = settings or NetworkSettings()
    hidden = _hidden(law, settings, linear_range)
    last = _last(law, settings, linear_range)
    return NetworkPolicy((*hidden, last), law.response, settings, policy_id)


def reembed(
    policy: NetworkPolicy,
    law: ModalPolicy,
    linear_range: float = LINEAR_RANGE,
    policy_id: str | None = None,
) -> NetworkPolicy:
    """Write a law into a network that carries an earlier one, the hidden layers frozen.

    Args:
        policy: What `embed` made of the earlier law.
        law: The new one, with the same modes and thresholds; K and the gains may differ.
        linear_range: α as it was then [1].
        policy_id: Name of the network; by default from its content.

    Returns:
        A network that shares the hidden layers of `policy`; only the last matrix is new.

    Raises:
        ConfigError: The hidden layers are those of other modes, thresholds or α.
    """
    first = _first(law, policy.settings, linear_range)
    if not np.array_equal(first, policy.weights[0]):
        raise ConfigError(
            f"the hidden layers of {policy.policy_id} are not those of the new law: other modes, "
            "thresholds or linear_range; give it the same modes, or embed it anew"
        )
    last = _last(law, policy.settings, linear_range)
    return NetworkPolicy((*policy.weights[:-1], last), law.response, policy.settings, policy_id)


def _hidden(law: ModalPolicy, settings: NetworkSettings, linear_range: float) -> Weights:
    n = len(law.gains)
    width = hidden_width(n)
    second, third = np.zeros((2, width, width), dtype=np.float32)
    linear, bent = np.arange(n), np.arange(n, 2 * n)
    second[linear, linear] = third[linear, linear] = third[bent, bent] = 1.0
    second[bent, bent] = linear_range
    return _first(law, settings, linear_range), second, third


def _first(law: ModalPolicy, settings: NetworkSettings, linear_range: float) -> NDArray[np.float32]:
    n = len(law.gains)
    first = np.zeros((hidden_width(n), n), dtype=np.float32)
    first[:n] = linear_range * law.modes.T
    first[n : 2 * n] = _slopes(law.thresholds, settings.input_scale)[:, None] * law.modes.T
    return first


def _last(law: ModalPolicy, settings: NetworkSettings, linear_range: float) -> NDArray[np.float32]:
    n = len(law.gains)
    far, near = law.inverse @ law.modes, law.near_inverse @ law.modes * law.gains
    linear = np.isinf(law.thresholds)
    last = np.zeros((len(far), hidden_width(n)), dtype=np.float32)
    last[:, :n] = -np.where(linear, near, far) * (settings.input_scale / linear_range)
    bend = np.where(linear, 0.0, law.thresholds)
    last[:, n : 2 * n] = (far - near) * (bend / linear_range)
    return last


def _slopes(thresholds: Vector, input_scale: float) -> Vector:
    """Give s / δ, and 0 where the law of a mode has no bend (δ of 0 or infinity)."""
    bent = np.isfinite(thresholds) & (thresholds > 0.0)
    return np.divide(input_scale, thresholds, out=np.zeros_like(thresholds), where=bent)
