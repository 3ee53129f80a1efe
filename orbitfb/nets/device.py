"""Where tensors live: the processor, or a GPU when there is one."""

import torch

from orbitfb.core.errors import ConfigError


def pick_device(name: str) -> torch.device:
    """Give the device that a setting names.

    Args:
        name: `auto` (a GPU if there is one), `cpu` or `cuda`.

    Returns:
        The device.

    Raises:
        ConfigError: The name is another one, or a GPU is asked for and there is none.
    """
    if name not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device is {name!r}; it can be auto, cpu or cuda")
    present = torch.cuda.is_available()
    if name == "cuda" and not present:
        raise ConfigError(
            "device is 'cuda', but torch sees no GPU here; set it to auto or cpu, or install the "
            "CUDA build of torch and the driver"
        )
    return torch.device("cuda" if present and name != "cpu" else "cpu")
