"""A lattice file as pyAT reads it, and the optics at the middle of its elements.

pyAT is an extra and has no types: all that touches it is here. It is imported only when a lattice
is read.
"""

import importlib
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from orbitfb.core.errors import ExchangeError
from orbitfb.core.signals import Vector

SUFFIXES = (".m", ".mat", ".json")
"""Formats that are taken. A `.m` file is evaluated by pyAT, as MATLAB would."""


@dataclass(frozen=True, slots=True)
class Element:
    """One element of a lattice.

    Args:
        family: Its name; many may have one.
        name: Of the attribute that was asked for; empty: it has none.
        kind: Its class in pyAT, such as `Quadrupole`.
        length: [m].
        gradient: Integrated quadrupole k1 L [1/m].
        sextupole: Integrated b2 L [1/m²].
        kicks: Whether it has kick angles.
    """

    family: str
    name: str
    kind: str
    length: float
    gradient: float
    sextupole: float
    kicks: bool


@dataclass(frozen=True, slots=True, eq=False)
class Optics:
    """Optics of a closed ring at the middle of some elements.

    Args:
        s: Shape (k,) [m].
        beta: Rows x and y, shape (2, k) [m].
        phase: Advance from s = 0, rows x and y, shape (2, k) [2π].
        dispersion: Horizontal, shape (k,) [m].
        tunes: With their integer parts, x and y [1].
        alpha_c: Momentum compaction factor [1].
        circumference: [m].
    """

    s: Vector
    beta: Vector
    phase: Vector
    dispersion: Vector
    tunes: tuple[float, float]
    alpha_c: float
    circumference: float


class Lattice:
    """A lattice, all its periods one after the other.

    Args:
        path: The file.
        variable: Which of several lattices in it; None: the only one.

    Raises:
        ExchangeError: pyAT is not installed, or does not take the file.
    """

    def __init__(self, path: Path, variable: str | None = None) -> None:
        self.path = path
        self._at = _toolbox()
        if path.suffix not in SUFFIXES:
            raise ExchangeError(f"{path}: a lattice is a file {', '.join(SUFFIXES)} of pyAT")
        if not path.is_file():
            raise ExchangeError(f"{path}: there is no such file")
        if variable is not None and path.suffix != ".mat":
            raise ExchangeError(f"{path} holds one lattice; --variable is for .mat files")
        chosen = {} if variable is None else {"use": variable}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                loaded: Any = self._at.load_lattice(path, **chosen)
            except Exception as error:  # its readers raise whatever they meet
                raise ExchangeError(
                    f"{path}: pyAT does not take it: {type(error).__name__}: {error}; name the "
                    "variable with --variable if there are several"
                ) from None
        self.energy = float(loaded.energy)
        self._elements: list[Any] = [
            element.deepcopy() for _ in range(int(loaded.periodicity)) for element in loaded
        ]

    @property
    def harmonic(self) -> int | None:
        """Of its cavities; None: there is none."""
        numbers = {
            int(element.HarmNumber) for element in self._elements if hasattr(element, "HarmNumber")
        }
        return numbers.pop() if len(numbers) == 1 else None

    def elements(self, attribute: str | None) -> list[Element]:
        """Tell of every element.

        Args:
            attribute: Which holds its own name; None: none does.
        """
        return [_told(element, attribute) for element in self._elements]

    def optics(self, where: Sequence[int]) -> Optics:
        """Compute the optics without cavities at the middle of some elements.

        Args:
            where: Their k indices, rising.

        Raises:
            ExchangeError: The lattice has no stable closed optics.
        """
        halves, middle = [], []
        chosen = set(where)
        for index, element in enumerate(self._elements):
            if index not in chosen:
                halves.append(element)
                continue
            parts = element.divide([0.5, 0.5]) if element.Length > 0 else [element]
            middle.append(len(halves) + len(parts) - 1)
            halves += parts
        everywhere = np.arange(len(halves) + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                ring = self._at.Lattice(halves, energy=self.energy, periodicity=1)
                ring.disable_6d()
                _, _, optics = self._at.get_optics(ring, everywhere)
                alpha_c = float(ring.get_mcf())
            except Exception as error:  # a singular matrix, a missing attribute, …
                raise ExchangeError(
                    f"{self.path}: pyAT finds no optics: {type(error).__name__}: {error}"
                ) from None
        s = np.asarray(ring.get_s_pos(everywhere), dtype=np.float64)
        turns = np.asarray(optics.mu, dtype=np.float64).T / (2 * np.pi)
        beta = np.asarray(optics.beta, dtype=np.float64).T
        if not (np.isfinite(beta).all() and (beta > 0).all() and np.isfinite(alpha_c)):
            raise ExchangeError(f"{self.path}: the lattice has no stable closed optics")
        dispersion = np.asarray(optics.dispersion, dtype=np.float64)[:, 0]
        tunes = float(turns[0, -1]), float(turns[1, -1])
        return Optics(
            s[middle], beta[:, middle], turns[:, middle], dispersion[middle], tunes, alpha_c,
            float(s[-1]),
        )  # fmt: skip


def _toolbox() -> Any:
    try:
        return importlib.import_module("at")
    except ImportError:
        raise ExchangeError(
            "reading a lattice takes pyAT: pip install 'orbitfb[lattice]'"
        ) from None


def _told(element: Any, attribute: str | None) -> Element:
    length = float(element.Length)
    scale = length or 1.0
    name = "" if attribute is None else str(getattr(element, attribute, "") or "").strip()
    return Element(
        str(element.FamName),
        name,
        type(element).__name__,
        length,
        _order(element, 1) * scale,
        _order(element, 2) * scale,
        hasattr(element, "KickAngle"),
    )


def _order(element: Any, order: int) -> float:
    strengths = np.atleast_1d(getattr(element, "PolynomB", np.zeros(0)))
    return float(strengths[order]) if len(strengths) > order else 0.0
