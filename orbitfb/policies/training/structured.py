"""Train the structured law: the form of `policies.modal`, its numbers by gradient.

    a = −W diag(g / D) Wᵀ Rᵀ U f(Uᵀ e),     f_i(z) = z − (1 − L_i) δ_i tanh(z / δ_i)

with RᵀR + λ² + n P = W D Wᵀ. Trained are, mode by mode, the gain g far from zero, the gain L at
the noise floor and the threshold δ between them: 3 n numbers instead of 0.7 million, so that a
few hundred iterations of a second or two suffice, nothing precise is destroyed, and every
number can be read. A trained g below 1 says that a mode is not trusted; it is kept in the law as
covariance, to which P = W diag(D (1/g − 1) / n) Wᵀ is added, and so goes wherever a law goes:
into the store, or by `policies.embedding.embed` into the 3 × 512 network.

Whether it paid is seen on trajectories that were not trained on, of the last stage of the
curriculum, from the same first orbits and with the same noise for the start and for what became
of it: a training that was cut short can end in a worse law than it began with.

Training pays where the drawn responses cover what the ring will do; where they do not, the
training fits the wrong ring (see the figures before and after).
"""

import time
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.nets.checkpoint import Checkpoint
from orbitfb.nets.device import pick_device
from orbitfb.nets.training import Progress, train
from orbitfb.policies.inverse import checked_response, content_hash
from orbitfb.policies.modal import ModalPolicy, ModalSettings
from orbitfb.policies.training.rehearsal import Rehearsal, judge, spectral_radius
from orbitfb.policies.training.result import TrainingResult
from orbitfb.policies.training.rollout import (
    Draw,
    LinearResponses,
    ModelAt,
    TrajectoryLoss,
    drawn,
    learning_rate,
)
from orbitfb.policies.training.trajectory_settings import StructuredSettings

_EDGE = 1e-3
_TRUST = 0.95
_JUDGED = 16
_HELD_OUT = 256
"""Trajectories, at least, on which start and trained law are compared."""


def train_structured(
    response: Vector,
    settings: StructuredSettings | None = None,
    *,
    start: ModalPolicy | None = None,
    draw: Draw | None = None,
    device: str = "auto",
    progress: Progress | None = None,
    checkpoint: Path | None = None,
    keep_better: bool = False,
) -> TrainingResult[ModalPolicy]:
    """Train gains and thresholds of the modal law through the system model.

    Args:
        response: R, shape (n, m) [m/A]: the model, and what the law inverts.
        settings: Trajectories, loss, optimiser, and which numbers are trained.
        start: Law to begin with; None: the modal law with its default gains.
        draw: Gives the response matrices of an iteration, shape (S, n, m) [m/A], in place of R.
        device: `auto`, `cpu` or `cuda`.
        progress: Told after every iteration.
        checkpoint: Directory to keep the training in, and to resume it from.
        keep_better: Whether the start is given back when the trained law is no better than it on
            held-out trajectories.

    Returns:
        The law, and figures: `held_out_before` and `held_out_after`, the loss on trajectories
        that were not trained on [1]; `improved` (1 when it fell); `before_…` and `after_…` score
        [1], floor [m], worst [m] of 60 steps in closed loop on R or on drawn responses;
        `spectral_radius` of the law given back [1], `seconds`, `loss` [1].

    Raises:
        ConfigError: The start is of another ring, or a GPU that is not there.
        TrainingError: Loss or gradient are not finite.
    """
    settings = settings or StructuredSettings()
    response = checked_response(response)
    law = start or ModalPolicy(response, ModalSettings())
    if law.response.shape != response.shape:
        raise ConfigError(
            f"the start is a law for {law.response.shape} (BPMs, correctors), the response matrix "
            f"has {response.shape}; give one of the same ring"
        )
    target = pick_device(device)
    module = StructuredLaw(response, law, settings).to(target)
    generator = torch.Generator().manual_seed(settings.seed)
    model_at = drawn(draw, LinearResponses(response, target), settings, settings.seed, target)
    loss = TrajectoryLoss(
        module, model_at, response, settings, settings.iterations, generator, target
    )
    purpose = {
        "settings": settings.model_dump(mode="json"),
        "response": content_hash(settings, response),
        "start": law.policy_id,
    }
    began = time.perf_counter()
    curve = train(
        {"law": module},
        loss,
        iterations=settings.iterations,
        learning_rate=learning_rate(
            settings.learning_rate, settings.final_learning_rate, settings.iterations
        ),
        generator=generator,
        clip=settings.clip,
        progress=progress,
        checkpoint=None if checkpoint is None else Checkpoint(checkpoint, purpose),
    )
    seconds = time.perf_counter() - began
    trained = module.export()
    held_out = {
        "held_out_before": _held_out(law, model_at, response, settings, target),
        "held_out_after": _held_out(trained, model_at, response, settings, target),
    }
    improved = held_out["held_out_after"] < held_out["held_out_before"]
    kept = trained if improved or not keep_better else law
    rings = response[None] if draw is None else draw(np.random.default_rng(settings.seed))
    rings = np.resize(rings, (_JUDGED, *response.shape))
    trial = Rehearsal(
        amplitude=settings.amplitude,
        reading_noise=settings.reading_noise,
        orbit_noise=settings.orbit_noise,
        seed=settings.seed,
    )
    verdicts = {"before": judge(law, rings, trial), "after": judge(trained, rings, trial)}
    return TrainingResult(
        policy=kept,
        method="structured",
        settings=settings.model_dump(mode="json"),
        seeds={"seed": settings.seed, "held_out": settings.seed + 1},
        curve=tuple(curve),
        figures={
            **held_out,
            "improved": float(improved),
            **{
                f"{when}_{name}": getattr(verdict, name)
                for when, verdict in verdicts.items()
                for name in ("score", "floor", "worst")
            },
            "spectral_radius": spectral_radius(kept.gain_matrix, response),
            "seconds": seconds,
            "loss": curve[-1] if curve else float("nan"),
        },
    )


def _held_out(
    law: ModalPolicy,
    model_at: ModelAt,
    response: Vector,
    settings: StructuredSettings,
    device: torch.device,
) -> float:
    """Give the loss on trajectories and responses of an iteration that was not made."""

    def changes(reading: Tensor) -> Tensor:
        asked = law.changes(reading.cpu().numpy().astype(np.float64))
        return torch.from_numpy(asked.astype(np.float32)).to(device)

    many = settings.model_copy(update={"batch": max(settings.batch, _HELD_OUT)})
    generator = torch.Generator().manual_seed(settings.seed + 1)
    last = settings.iterations
    loss = TrajectoryLoss(changes, model_at, response, many, last, generator, device)
    with torch.no_grad():
        return float(loss(last))


class StructuredLaw(torch.nn.Module):
    """The modal law with gains and thresholds that can be trained.

    Args:
        response: R, shape (n, m) [m/A].
        law: Where gains, thresholds, modes and covariance begin.
        settings: Which of them are trained.
    """

    def __init__(self, response: Vector, law: ModalPolicy, settings: StructuredSettings) -> None:
        super().__init__()
        self._response, self._law, self._settings = response, law, settings
        n, m = response.shape
        damped = response.T @ response + np.diag(law.damping**2)
        if law.covariance is not None:
            damped += n * law.covariance
        values, self._directions = np.linalg.eigh(damped)
        self._values = np.maximum(values, np.finfo(np.float64).eps * m * values[-1])
        bent = np.isfinite(law.thresholds) & (law.thresholds > 0.0)
        unit = np.where(bent, law.thresholds, 1.0)
        reached = self._directions.T @ response.T @ law.modes / self._values[:, None]
        for name, matrix in (
            ("decompose", law.modes.T),
            ("reached", reached),
            ("compose", -self._directions),
            ("bent", bent),
            ("linear", np.isinf(law.thresholds)),
        ):
            tensor = torch.from_numpy(np.ascontiguousarray(matrix, dtype=np.float32))
            self.register_buffer(name, tensor, persistent=False)
        edge = np.clip(law.gains, _EDGE, 1.0 - _EDGE)
        self.floor = _parameter(np.log(edge / (1.0 - edge)), "floor" in settings.trained)
        self.threshold = _parameter(np.log(unit), "threshold" in settings.trained)
        trust = np.full(m, np.log(_TRUST / (1.0 - _TRUST)))
        self.far = _parameter(trust, "far" in settings.trained)

    def forward(self, reading: Tensor) -> Tensor:
        """Give changes, shape (B, m) [A], for readings of shape (B, n) [m]."""
        z = torch.nn.functional.linear(reading, self.get_buffer("decompose"))
        gains, bent = torch.sigmoid(self.floor), self.get_buffer("bent")
        thresholds = torch.exp(self.threshold)
        z = z * torch.where(self.get_buffer("linear") > 0, gains, torch.ones_like(gains))
        z = z - bent * (1.0 - gains) * thresholds * torch.tanh(z / thresholds)
        y = torch.nn.functional.linear(z, self.get_buffer("reached"))
        if "far" in self._settings.trained:
            y = y * torch.sigmoid(self.far)
        return torch.nn.functional.linear(y, self.get_buffer("compose"))

    def export(self) -> ModalPolicy:
        """Make a law of the numbers reached so far."""
        law, trained = self._law, self._settings.trained
        gains, thresholds, covariance = law.gains, law.thresholds, law.covariance
        if "floor" in trained:
            gains = _values(torch.sigmoid(self.floor))
        if "threshold" in trained:
            reached = _values(torch.exp(self.threshold))
            thresholds = np.where(_values(self.get_buffer("bent")) > 0, reached, thresholds)
        if "far" in trained:
            doubt = self._values * np.exp(-_values(self.far)) / len(self._response)
            added = (self._directions * doubt) @ self._directions.T
            covariance = added if covariance is None else covariance + added
        # What was trained has one inverse, near zero and far from it.
        settings = law.settings.model_copy(update={"near_caution": 1.0})
        return ModalPolicy(self._response, settings, law.modes, gains, thresholds, covariance)


def _parameter(values: Vector, trained: bool) -> torch.nn.Parameter:
    tensor = torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
    return torch.nn.Parameter(tensor, requires_grad=trained)


def _values(tensor: Tensor) -> Vector:
    return tensor.detach().cpu().numpy().astype(np.float64)
