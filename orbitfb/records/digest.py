"""The digest that names the data of a record."""

import hashlib

import numpy as np

from orbitfb.core.signals import Vector


def digest_of(*arrays: Vector) -> str:
    """Give the SHA-256 of arrays, their shapes included, hexadecimal."""
    digest = hashlib.sha256()
    for array in arrays:
        plain = np.ascontiguousarray(array, dtype="<f8")
        digest.update(repr(plain.shape).encode())
        digest.update(plain.tobytes())
    return digest.hexdigest()
