"""The answer of a diagnosis of a response, as `diagnosis.json` holds it."""

import json
import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict

SCHEMA_VERSION = 1
State = Literal["named", "ambiguous", "no_gap", "unknown"]


def _number(value: Any) -> float | None:
    if value is None:
        return None
    plain = float(value)
    return float(f"{plain:.6e}") if math.isfinite(plain) else None


Number = Annotated[float | None, BeforeValidator(_number)]
"""A finite number, or null: not known."""


class Part(BaseModel):
    """A frozen part of the answer."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Alternative(Part):
    """Another place that explains it nearly as well."""

    place: str
    probability: Number


class Finding(Part):
    """A device that stands out (`named`) or nearly does: its kind, size and probability."""

    named: bool
    kind: str
    places: tuple[str, ...]
    value: Number
    sigma: Number
    unit: str
    z: Number
    probability: Number
    alternatives: tuple[Alternative, ...]
    text: str


class Reading(Part):
    """A BPM in one plane: gain, what it sees of the other plane, local phase."""

    name: str
    plane: str
    s_m: Number
    gain: Number
    gain_sigma: Number
    z: Number
    roll: Number
    roll_sigma: Number
    phase_rad: Number
    residual_m_per_rad: Number


class Kick(Part):
    """A corrector in one plane: calibration over the table's, tilt, local phase."""

    name: str
    plane: str
    s_m: Number
    calibration: Number
    calibration_sigma: Number
    z: Number
    tilt: Number
    tilt_sigma: Number
    phase_rad: Number
    energy_per_rad: Number


class Quadrupole(Part):
    """A quadrupole: ΔK/K, and its class where neighbours cannot be told apart."""

    name: str
    s_m: Number
    relative: Number
    sigma: Number
    z: Number
    degenerate_with: tuple[str, ...]
    integral_sigma: Number


class Skew(Part):
    """A quadrupole or sextupole that couples the planes, where cross blocks were measured."""

    name: str
    s_m: Number
    skew_per_m: Number
    sigma: Number
    z: Number


class Correlation(Part):
    """Two parameters that the response knows only together: kind and device of each."""

    first: str
    second: str
    correlation: Number


class Block(Part):
    """One block: relative residuals step by step, and χ² per degree of freedom."""

    read: str
    driven: str
    bpms: int
    correctors: int
    raw: Number
    scale: Number
    gains: Number
    optics: Number
    noise: Number
    noise_known: bool
    chi2_before: Number
    chi2_after: Number
    outliers: int


class Optics(Part):
    """Optics of a plane by the table and by the fit."""

    plane: str
    tune_table: Number
    tune_fit: Number
    beta_beat_rms: Number
    dispersion_change_rms_m: Number
    scale: Number


class Outlier(Part):
    """One element that is far from the fit; it does not count in it."""

    bpm: str
    corrector: str
    residual_m_per_rad: Number
    sigmas: Number


class Growth(Part):
    """Growth per tick of the SVD of the table, closed on the measured response."""

    planes: str
    per_tick: Number
    text: str


class ResponseDiagnosis(Part):
    """The diagnosis of a measured response."""

    schema_version: int
    source: str
    state: State
    headline: str
    notes: tuple[str, ...]
    gauge: str
    findings: tuple[Finding, ...]
    healthy_spread: dict[str, Number]
    sigma_widened: dict[str, Number]
    blocks: tuple[Block, ...]
    optics: tuple[Optics, ...]
    growth: tuple[Growth, ...]
    steps: int
    converged: bool
    bpms: tuple[Reading, ...]
    correctors: tuple[Kick, ...]
    quadrupoles: tuple[Quadrupole, ...]
    skews: tuple[Skew, ...]
    outliers: tuple[Outlier, ...]
    correlations: tuple[Correlation, ...]


def document(answer: ResponseDiagnosis) -> str:
    """Write the text of `diagnosis.json`."""
    content = answer.model_dump(mode="json")
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def schema() -> str:
    """Write the JSON schema."""
    content = ResponseDiagnosis.model_json_schema(mode="serialization")
    content["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    content["title"] = f"orbitfb diagnosis of a response {SCHEMA_VERSION}"
    return json.dumps(content, indent=2) + "\n"
