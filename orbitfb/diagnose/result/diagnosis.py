"""The answer of a diagnosis: what `diagnosis.json` holds and the report draws."""

import json
from pathlib import Path
from typing import Literal

from pydantic import Field, ValidationError

from orbitfb.core.errors import RecordError
from orbitfb.core.files.bounded import LARGEST_DIAGNOSIS, read_bytes
from orbitfb.diagnose.result.blocks import (
    AmbiguousSet,
    Audit,
    ClosedLoop,
    Fingerprint,
    Geometry,
    Identifiability,
    KStep,
    LagProfile,
    ScoreMap,
    Tournament,
    Unknown,
    WaterfallStep,
)
from orbitfb.diagnose.result.parts import (
    Cause,
    Detectable,
    Experiment,
    Finding,
    Gap,
    NotTested,
    Provenance,
    Shrink,
)
from orbitfb.diagnose.result.values import Part

State = Literal["no_gap", "named", "ambiguous", "named_plus_remainder", "unknown"]
SCHEMA_VERSION = "2.0"
"""Raised in front when a key goes or changes its meaning, behind when one is added."""


class Diagnosis(Part):
    """Where the gap lies, what causes it, how far it shrinks, what to do; null: not resolved."""

    schema_version: Literal["2.0"] = SCHEMA_VERSION
    state: State | None = Field(
        description="null when the integrity screen failed: nothing was estimated"
    )
    headline: str = Field(description="the answer in one sentence")
    causes: tuple[Cause, ...] = ()
    gap: Gap | None = None
    shrink: Shrink | None = None
    experiment: Experiment | None = None
    not_tested: tuple[NotTested, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    findings: tuple[Finding, ...] = Field(default=(), description="of the integrity screen")
    provenance: Provenance
    ambiguous: tuple[AmbiguousSet, ...] = ()
    unknown: Unknown | None = None
    k_steps: tuple[KStep, ...] = ()
    closed_loop: ClosedLoop | None = None
    tournament: Tournament | None = None
    waterfall: tuple[WaterfallStep, ...] = ()
    audit: Audit | None = None
    fingerprints: tuple[Fingerprint, ...] = ()
    score_map: ScoreMap | None = None
    lag_profile: LagProfile | None = None
    identifiability: Identifiability | None = None
    geometry: Geometry | None = None

    @property
    def failed(self) -> bool:
        """Whether the integrity screen found what makes every estimate worthless."""
        return self.state is None


def document(diagnosis: Diagnosis) -> str:
    """Write a diagnosis as the text of `diagnosis.json`."""
    content = diagnosis.model_dump(mode="json")
    return json.dumps(content, indent=1, allow_nan=False, ensure_ascii=False) + "\n"


def read_diagnosis(path: Path) -> Diagnosis:
    """Read a `diagnosis.json`.

    Raises:
        RecordError: It cannot be read, or is no diagnosis of this version.
    """
    try:
        content = read_bytes(path, LARGEST_DIAGNOSIS, RecordError, "name a diagnosis.json")
        return Diagnosis.model_validate_json(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"]) or "the top"
        raise RecordError(
            f"{path}: it is no diagnosis of version {SCHEMA_VERSION}: {where}: {first['msg']}"
        ) from None


def schema() -> str:
    """Write the JSON schema of `diagnosis.json`."""
    content = Diagnosis.model_json_schema(mode="serialization")
    content["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    content["title"] = f"orbitfb diagnosis {SCHEMA_VERSION}"
    return json.dumps(content, indent=2) + "\n"
