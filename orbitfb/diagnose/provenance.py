"""What computes a diagnosis."""

import platform

import numpy as np
import scipy

from orbitfb import __version__


def versions() -> dict[str, str]:
    """Versions of what computes a diagnosis."""
    return {
        "orbitfb": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
