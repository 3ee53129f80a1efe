"""Train the forward net on archives, keep it, find it again."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orbitfb.app.train.ground import find_ground
from orbitfb.app.train.request import Progress, TrainingRequest, check
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError, EstimationError, StoreError
from orbitfb.core.signals import Channels
from orbitfb.history.archive import read_archive
from orbitfb.models.rows import select_rows

if TYPE_CHECKING:
    from orbitfb.models.forward.net import ForwardNet


def models_directory(config: AppConfig) -> Path:
    """Say where models are kept."""
    return config.data_directory / "models"


def train_model(
    config: AppConfig, request: TrainingRequest, progress: Progress = lambda *_: None
) -> dict[str, Any]:
    """Train a forward net on one archive, validate it on another, keep it.

    A net that fails its validation is kept as well, to be looked at; nothing trains on it.

    Args:
        config: Names ring and directory; holds the settings.
        request: What is asked for.
        progress: Told after every iteration.

    Returns:
        Name and figures (`orbitfb.models.forward.validation.validate`).

    Raises:
        ConfigError: The request makes no sense.
        OrbitFeedbackError: Data or training failed; nothing was kept.
    """
    check(request)
    from orbitfb.models.forward.files import save_forward
    from orbitfb.models.forward.fit import fit_forward
    from orbitfb.nets.checkpoint import Checkpoint

    ground = find_ground(config, request)
    if ground.transitions is None or request.validation is None:
        raise ConfigError("a forward net needs two archives")  # `check` has seen to it
    settings = config.train.forward.model_copy(update=request.given())
    tolerance = config.learn.tolerance
    kept = config.data_directory / "training" / request.fingerprint
    checkpoint = Checkpoint(kept, {"settings": settings.model_dump(mode="json")})
    if request.fresh:
        checkpoint.remove()
    validation = read_archive(request.validation, ground.channels)
    shared = int(np.isin(validation.time, ground.transitions.time).sum())
    if shared:
        raise EstimationError(
            f"{shared} of {len(validation)} transitions of {request.validation} are in "
            f"{request.archive} too; data that were used for training prove nothing: validate on "
            "another run"
        )
    net = fit_forward(
        select_rows(ground.transitions, tolerance),
        select_rows(validation, tolerance),
        ground.response,
        settings,
        request.device,
        lambda done, loss: progress(done, settings.iterations, loss),
        checkpoint,
    )
    save_forward(net, models_directory(config) / request.fingerprint)
    checkpoint.remove()
    kept.rmdir()
    return {"stored": request.fingerprint, "method": request.method} | dict(net.figures)


def load_model(config: AppConfig, name: str, channels: Channels) -> "ForwardNet":
    """Load a forward net that passed its validation.

    Raises:
        StoreError: There is none of that name, it is damaged, or of another ring.
        EstimationError: It did not pass.
    """
    from orbitfb.models.forward.files import load_forward

    directory = models_directory(config) / name
    if Path(name).name != name or not directory.is_dir():
        raise StoreError(
            f"there is no model {name!r} in {models_directory(config)}; `orbitfb train forward` "
            "makes one and says its name"
        )
    net = load_forward(directory)
    shape = (len(channels.bpms), len(channels.correctors))
    if net.response.shape != shape:
        raise StoreError(
            f"{directory} is a model for {net.response.shape} (BPMs, correctors), the ring has "
            f"{shape}; train one for this ring"
        )
    if not net.figures.get("trusted"):
        raise EstimationError(
            f"{directory} failed its validation (slope {net.figures.get('slope', 0.0):.3g}, see "
            "its card.json), so that nothing should be trained on it; record with more excitation"
        )
    return net
