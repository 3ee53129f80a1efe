"""A training that was interrupted, on disk: whole or not at all, and never pickled.

    DIRECTORY/card.json                    step, purpose, name and hash of the tensors
    DIRECTORY/state-<hash>.safetensors     weights, optimiser, generator, curve

The tensors are on disk before the card that names them takes the place of the old card, so a
reader sees the old checkpoint or the new one, also after a kill or a power cut.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as save_tensors

from orbitfb.core.errors import StoreError
from orbitfb.core.files.bounded import take
from orbitfb.core.files.state import make_directory, replace_file

Modules = Mapping[str, torch.nn.Module]
"""What is trained, by name; names without a dot."""

_SCHEMA_VERSION = 1
_LARGEST_CARD = 2**20
_LARGEST_TENSORS = 2**33
_GENERATOR, _CURVE = "generator", "curve"


class Checkpoint:
    """The one checkpoint of one training.

    Args:
        directory: Where it is kept; made when it is first saved.
        purpose: What the training is (settings, seeds, hash of the data): plain JSON. A
            checkpoint of another purpose is refused, so that nobody resumes the wrong one.
    """

    def __init__(self, directory: Path, purpose: Mapping[str, Any] | None = None) -> None:
        self.directory = Path(directory)
        self._purpose = json.loads(json.dumps(dict(purpose or {})))

    def exists(self) -> bool:
        """Whether there is something to resume."""
        return self._card_path.exists()

    def save(
        self,
        step: int,
        modules: Modules,
        optimiser: torch.optim.Optimizer,
        generator: torch.Generator,
        curve: list[float],
    ) -> None:
        """Put the state after `step` iterations in the place of what was there.

        Raises:
            StoreError: It cannot be written; the old checkpoint stays.
        """
        tensors = {
            f"module.{name}.{key}": value.detach().cpu().contiguous()
            for name, module in modules.items()
            for key, value in module.state_dict().items()
        }
        for index, entries in optimiser.state_dict()["state"].items():
            for key, value in entries.items():
                tensors[f"optimiser.{index}.{key}"] = torch.as_tensor(value).cpu().contiguous()
        tensors[_GENERATOR] = generator.get_state()
        tensors[_CURVE] = torch.tensor(curve, dtype=torch.float64)
        content = save_tensors(tensors)
        digest = hashlib.sha256(content).hexdigest()
        card = {
            "schema_version": _SCHEMA_VERSION,
            "step": step,
            "purpose": self._purpose,
            "tensors": f"state-{digest[:16]}.safetensors",
            "bytes": len(content),
            "sha256": digest,
        }
        try:
            make_directory(self.directory)
            replace_file(self.directory / card["tensors"], content)
            replace_file(self._card_path, json.dumps(card, indent=2).encode())
            self._sweep(card["tensors"])
        except OSError as error:
            raise StoreError(
                f"the checkpoint {self.directory} cannot be written ({error.strerror}); name "
                "another directory or repair its permissions"
            ) from error

    def load(
        self, modules: Modules, optimiser: torch.optim.Optimizer, generator: torch.Generator
    ) -> tuple[int, list[float]]:
        """Put modules, optimiser and generator where the training was left.

        Returns:
            Iterations done, and the loss at each of them.

        Raises:
            StoreError: There is none, it is damaged, or it is of another training.
        """
        card = self._card()
        tensors = self._tensors(card)
        generator.set_state(tensors.pop(_GENERATOR))
        curve = tensors.pop(_CURVE).tolist()
        state = optimiser.state_dict()
        state["state"] = {}
        weights: dict[str, dict[str, torch.Tensor]] = {name: {} for name in modules}
        for name, tensor in tensors.items():
            kind, owner, key = name.split(".", 2)
            if kind == "optimiser":
                state["state"].setdefault(int(owner), {})[key] = tensor
            else:
                weights.setdefault(owner, {})[key] = tensor
        try:
            for name, entries in weights.items():
                modules[name].load_state_dict(entries)
            optimiser.load_state_dict(state)
        except (KeyError, RuntimeError, ValueError) as error:
            raise StoreError(
                f"the checkpoint {self.directory} is of another network ({error}); {self._advice}"
            ) from error
        return card["step"], curve

    def remove(self) -> None:
        """Take the checkpoint away when the training is complete."""
        self._card_path.unlink(missing_ok=True)
        if self.directory.exists():
            self._sweep("")

    @property
    def _card_path(self) -> Path:
        return self.directory / "card.json"

    @property
    def _advice(self) -> str:
        return f"remove {self.directory} to train from the start"

    def _card(self) -> dict[str, Any]:
        try:
            with self._card_path.open("rb") as file:
                card = json.loads(file.read(_LARGEST_CARD))
            if card["schema_version"] != _SCHEMA_VERSION:
                raise ValueError(f"schema_version {card['schema_version']!r} is another version")
            name, purpose = card["tensors"], card["purpose"]
            sane = isinstance(card["bytes"], int) and 0 < card["bytes"] <= _LARGEST_TENSORS
            if Path(name).name != name or not isinstance(card["step"], int) or not sane:
                raise ValueError("its entries make no sense")
        except OSError as error:
            raise StoreError(
                f"there is no checkpoint in {self.directory} ({error.strerror}); train from the "
                "start"
            ) from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise StoreError(f"{self._card_path} is damaged ({error}); {self._advice}") from error
        if purpose != self._purpose:
            other = sorted(
                key
                for key in purpose.keys() | self._purpose.keys()
                if purpose.get(key) != self._purpose.get(key)
            )
            raise StoreError(
                f"the checkpoint {self.directory} is of another training: {', '.join(other)} "
                f"differ; give it the same settings, or {self._advice}"
            )
        return card

    def _tensors(self, card: dict[str, Any]) -> dict[str, torch.Tensor]:
        path = self.directory / card["tensors"]
        try:
            with path.open("rb") as file:
                content = take(file, card["bytes"] + 1)
            if hashlib.sha256(content).hexdigest() != card["sha256"]:
                raise ValueError("it is not the file that its card names")
            return load_tensors(content)
        except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
            raise StoreError(f"{path} cannot be read ({error}); {self._advice}") from error

    def _sweep(self, kept: str) -> None:
        for pattern in ("state-*.safetensors", "*.unfinished"):
            for path in self.directory.glob(pattern):
                if path.name != kept:
                    path.unlink(missing_ok=True)
