"""What may be asked of `orbitfb train`, and what makes no sense."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from orbitfb.core.errors import ConfigError

Method = Literal["svd", "modal", "network", "structured", "supervised", "trajectory"]
"""How a policy is made; the first three are computed."""

METHODS: tuple[Method, ...] = get_args(Method)

FORWARD = "forward"
"""The word for training a model, the forward net."""

NOMINAL = "nominal"
"""The word for the response matrix of the optics."""

Progress = Callable[[int, int, float], None]
"""Told how many iterations are done, of how many, and the loss [1]."""


@dataclass(frozen=True, slots=True)
class TrainingRequest:
    """What is asked for.

    Args:
        method: One of `METHODS`, or `forward`.
        start: Response to begin from: `nominal`, or the id of a stored policy.
        archive: Operation to identify the response from, and for labels; None: none.
        validation: Operation with another excitation, to validate a forward net on.
        model: Stored forward net to train a trajectory policy on, in place of the response.
        published: Whether supervised or trajectory train as published, in place of the
            configured settings.
        warm: Whether the training begins with the network of the stored policy `start`.
        iterations: In place of the settings' number.
        seed: In place of the settings' seed.
        device: `auto`, `cpu` or `cuda`.
        fresh: Whether an interrupted training is thrown away, not resumed.
        activate: Whether the policy is put in force.
    """

    method: str
    start: str = NOMINAL
    archive: Path | None = None
    validation: Path | None = None
    model: str | None = None
    published: bool = False
    warm: bool = False
    iterations: int | None = None
    seed: int | None = None
    device: str = "auto"
    fresh: bool = False
    activate: bool = False

    @property
    def fingerprint(self) -> str:
        """Name the directory of a training, so that the same request finds it again."""
        paths = [None if path is None else str(path) for path in (self.archive, self.validation)]
        named = [self.start, *paths, self.model, self.published, self.warm, self.seed]
        digest = hashlib.sha256(json.dumps(named).encode()).hexdigest()[:12]
        return f"{self.method}-{digest}"

    def given(self) -> dict[str, int]:
        """Give the settings that the request replaces."""
        given = {"iterations": self.iterations, "seed": self.seed}
        return {key: value for key, value in given.items() if value is not None}


def check(request: TrainingRequest) -> None:
    """Refuse options that the method has no use for, rather than ignore them.

    Raises:
        ConfigError: The request makes no sense.
    """
    method = request.method
    if method not in (*METHODS, FORWARD):
        raise ConfigError(f"{method!r} cannot be trained; choose {', '.join((*METHODS, FORWARD))}")
    descending = ("structured", "supervised", "trajectory", FORWARD)
    for name, given, useful in (
        ("--iterations", request.iterations is not None, descending),
        ("--seed", request.seed is not None, descending),
        ("--published", request.published, ("supervised", "trajectory")),
        ("--warm", request.warm, ("trajectory",)),
        ("--model", request.model is not None, ("trajectory",)),
        ("--validate", request.validation is not None, (FORWARD,)),
        ("--activate", request.activate, METHODS),
        ("--device cuda", request.device == "cuda", descending),
    ):
        if given and method not in useful:
            raise ConfigError(f"{name} means nothing to the method {method}; leave it out")
    if request.iterations is not None and request.iterations < 1:
        raise ConfigError(f"--iterations {request.iterations}: give at least 1")
    if request.seed is not None and request.seed < 0:
        raise ConfigError(f"--seed {request.seed}: give 0 or more")
    if request.device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"--device {request.device}: choose auto, cpu or cuda")
    if request.warm and request.start == NOMINAL:
        raise ConfigError("--warm begins with a stored network: name it with --start ID")
    if method == FORWARD and (request.archive is None or request.validation is None):
        raise ConfigError(
            "a forward net needs --from ARCHIVE to learn from and --validate ARCHIVE with another "
            "excitation: dithered, explored, or under another policy"
        )
