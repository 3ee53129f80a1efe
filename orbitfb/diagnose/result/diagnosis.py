"""The answer of a diagnosis: the content of `diagnosis.json` and of the report."""

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
"""The first number rises when a key goes or changes its meaning, the second when one is added."""


class Diagnosis(Part):
    """Where the gap is, what causes it, how much of it goes, and what to do; null: not resolved."""

    schema_version: Literal["2.0"] = SCHEMA_VERSION
    state: State | None = Field(
        description="the kind of answer; null if the integrity screen failed"
    )
    headline: str = Field(description="the answer in a few sentences")
    causes: tuple[Cause, ...] = Field(default=(), description="named causes, the strongest first")
    gap: Gap | None = Field(default=None, description="size of the gap, and its parts")
    shrink: Shrink | None = Field(
        default=None, description="share of the gap that the causes remove"
    )
    experiment: Experiment | None = Field(default=None, description="recommended experiment")
    not_tested: tuple[NotTested, ...] = Field(
        default=(), description="effects that this record cannot show"
    )
    detectable: tuple[Detectable, ...] = Field(
        default=(), description="size of each effect that this record would have shown"
    )
    findings: tuple[Finding, ...] = Field(
        default=(), description="findings of the integrity screen"
    )
    provenance: Provenance = Field(description="data, versions and settings of this answer")
    ambiguous: tuple[AmbiguousSet, ...] = Field(
        default=(), description="sets of effects that the record cannot tell apart"
    )
    unknown: Unknown | None = Field(
        default=None, description="the part of the gap that no effect explains"
    )
    k_steps: tuple[KStep, ...] = Field(default=(), description="errors of longer predictions")
    closed_loop: ClosedLoop | None = Field(
        default=None, description="the orbit in closed loop, with and without the causes"
    )
    tournament: Tournament | None = Field(default=None, description="all effects compared")
    waterfall: tuple[WaterfallStep, ...] = Field(
        default=(), description="the rest of the gap after each cause"
    )
    audit: Audit | None = Field(default=None, description="tests of the model with the causes")
    fingerprints: tuple[Fingerprint, ...] = Field(
        default=(), description="pictures that show each effect best"
    )
    score_map: ScoreMap | None = Field(default=None, description="scores along the ring")
    lag_profile: LagProfile | None = Field(
        default=None, description="response to a change of the setpoints, by its age"
    )
    identifiability: Identifiability | None = Field(
        default=None, description="effects that look alike in this record"
    )
    geometry: Geometry | None = Field(default=None, description="positions of the devices")

    @property
    def failed(self) -> bool:
        """Whether the integrity screen failed, so that nothing was estimated."""
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
            f"{path}: this is not a diagnosis of version {SCHEMA_VERSION}: {where}: {first['msg']}"
        ) from None


def schema() -> str:
    """Write the JSON schema of `diagnosis.json`."""
    content = Diagnosis.model_json_schema(mode="serialization")
    content["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    content["title"] = f"orbitfb diagnosis {SCHEMA_VERSION}"
    return json.dumps(content, indent=2) + "\n"
