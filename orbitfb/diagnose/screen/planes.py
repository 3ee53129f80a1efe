"""The planes that are asked for, against those that the model of a record is in."""

from collections.abc import Iterable

from orbitfb.core.errors import ConfigError
from orbitfb.physics.places import Planes
from orbitfb.records.finding import Finding

_OTHER_PLANE = "swapped-planes"
"""The check that compares the model with that of the other plane."""


def check_planes(asked: Planes | None, findings: Iterable[Finding]) -> None:
    """Refuse planes that the model contradicts; where nobody asked it is the record that is wrong.

    Args:
        asked: By whoever asks for a diagnosis; None: those of the record.
        findings: Of the integrity screen.

    Raises:
        ConfigError: They are not those of the record.
    """
    for finding in findings:
        if asked is not None and finding.check == _OTHER_PLANE:
            raise ConfigError(f"--planes {asked}: {finding.text}, or leave the option out")
