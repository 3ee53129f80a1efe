"""Global parameters of a ring: the JSON file beside the table of places."""

from collections.abc import Mapping
from typing import Literal

from pydantic import Field, ValidationError

from orbitfb.core.errors import RingError
from orbitfb.core.files.bounded import parse_json
from orbitfb.core.settings import Settings

SPEED_OF_LIGHT = 299_792_458.0
"""Speed of light [m/s]."""

_NO_CLOSED_ORBIT = 1e-4
"""Nearer than this to a half-integer tune there is no orbit response worth the name."""


class RingParameters(Settings):
    """What the optics need beside the places."""

    energy_eV: float = Field(gt=0, description="Energy of the beam [eV].")  # noqa: N815
    circumference_m: float = Field(gt=0, description="Length of the design orbit [m].")
    harmonic: int = Field(gt=0, description="RF periods per turn.")
    nu_x: float = Field(gt=0, description="Horizontal tune with its integer part.")
    nu_y: float = Field(gt=0, description="Vertical tune with its integer part.")
    alpha_c: float = Field(description="Momentum compaction factor.")
    counts: Mapping[Literal["BPM", "COR", "QUAD", "SEXT"], int] = Field(
        default={},
        description="Places of a kind that the table must have; a kind left out is not checked.",
    )

    @property
    def circumference(self) -> float:
        """Length of the design orbit [m]."""
        return self.circumference_m

    @property
    def rf_frequency(self) -> float:
        """Nominal RF frequency of the ultra-relativistic beam [Hz]."""
        return self.harmonic * SPEED_OF_LIGHT / self.circumference_m


def parse_parameters(text: str, source: str) -> RingParameters:
    """Parse and validate the parameters.

    Args:
        text: The JSON document.
        source: Name of the file, for messages.

    Raises:
        RingError: It is no JSON, a key is missing, unknown or out of range, or a tune is resonant.
    """
    document = parse_json(text, source, RingError)
    try:
        parameters = RingParameters.model_validate(document)
    except ValidationError as error:
        faults = "\n".join(
            f"  {'.'.join(map(str, fault['loc'])) or '(document)'} = {fault['input']!r}: "
            f"{fault['msg']}"
            for fault in error.errors(include_url=False)
        )
        raise RingError(f"{source}: wrong parameters of the ring, correct them:\n{faults}") from (
            error
        )
    for key, tune in (("nu_x", parameters.nu_x), ("nu_y", parameters.nu_y)):
        if abs(2 * tune - round(2 * tune)) < 2 * _NO_CLOSED_ORBIT:
            raise RingError(
                f"{source}: {key} = {tune} is an integer or half-integer resonance, where no "
                "closed orbit exists; give the tune of the working point with its integer part"
            )
    if parameters.alpha_c == 0:
        raise RingError(
            f"{source}: alpha_c = 0 makes the dispersion term infinite; give the momentum "
            "compaction factor of the ring"
        )
    return parameters
