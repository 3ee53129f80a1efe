"""The paper's network: matrices with tanh between them, no bias, zero out for zero in."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from orbitfb.core.errors import ConfigError

Weights = tuple[NDArray[np.float32], ...]
"""The matrices of a network from the first layer to the last, each of shape (out, in)."""


class Perceptron(torch.nn.Module):
    """A fully connected network without biases: y = s · Wₖ tanh(… tanh(W₁ x)).

    Every weight is drawn uniformly within ± 1/√(inputs of its layer), from a generator of its
    own, so a seed gives the same network on every device.

    Args:
        sizes: Widths from the input to the output; at least two.
        seed: Seed of the weights.
        output_scale: The factor s. It stands outside the last matrix, so that it scales what a
            step of the optimiser does to the output as much as the output itself.
    """

    def __init__(self, sizes: Sequence[int], seed: int, output_scale: float = 1.0) -> None:
        super().__init__()
        if len(sizes) < 2 or min(sizes) < 1:
            raise ConfigError(
                f"a network of widths {list(sizes)} is none; give at least an input and an output"
            )
        if not (np.isfinite(output_scale) and output_scale != 0.0):
            raise ConfigError(f"output_scale is {output_scale}; it must be a number other than 0")
        self.sizes = tuple(sizes)
        self.output_scale = output_scale
        generator = torch.Generator().manual_seed(seed)
        self.weights = torch.nn.ParameterList(
            torch.nn.Parameter(
                (2.0 * torch.rand(outputs, inputs, generator=generator) - 1.0) / inputs**0.5
            )
            for inputs, outputs in pairwise(self.sizes)
        )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Apply the network.

        Args:
            x: Shape (..., inputs).

        Returns:
            Shape (..., outputs).
        """
        *hidden, last = self.weights
        for weight in hidden:
            x = torch.tanh(torch.nn.functional.linear(x, weight))
        return self.output_scale * torch.nn.functional.linear(x, last)

    def arrays(self) -> Weights:
        """Copy the matrices to numpy; the output scale is multiplied into the last one."""
        arrays = [weight.detach().cpu().numpy().copy() for weight in self.weights]
        arrays[-1] *= np.float32(self.output_scale)
        return tuple(arrays)

    def load_arrays(self, arrays: Sequence[NDArray[np.float32]]) -> None:
        """Take over the matrices that `arrays` gave.

        Raises:
            ConfigError: They are of another network.
        """
        shapes = [tuple(weight.shape) for weight in self.weights]
        given = [array.shape for array in arrays]
        if given != shapes:
            raise ConfigError(f"the matrices have shapes {given}, this network needs {shapes}")
        *hidden, last = arrays
        with torch.no_grad():
            for weight, array in zip(
                self.weights, [*hidden, last / np.float32(self.output_scale)], strict=True
            ):
                weight.copy_(torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)))
