"""The parts that every diagnosis has: causes, gap, shrink, experiment, limits, provenance."""

from typing import Literal

from pydantic import Field

from orbitfb.diagnose.result.values import Number, Numbers, Part
from orbitfb.effects.kinds import Stage

Severity = Literal["note", "warning", "failure"]


class ParameterValue(Part):
    """An estimated parameter of an effect."""

    value: Number = Field(description="estimate, in `unit`")
    low: Number = Field(default=None, description="lower end of the 90 % interval")
    high: Number = Field(default=None, description="upper end of the 90 % interval")
    unit: str = Field(description="SI unit, `1` for a ratio")
    at_bound: bool = Field(
        default=False, description="whether the fit ended at a bound; then do not trust the value"
    )
    meaning: str = Field(default="", description="what the value stands for, if it is a choice")


class PlaceValues(Part):
    """Devices of a cause that have the same values."""

    places: tuple[str, ...] = Field(description="names of the devices; empty for the whole ring")
    planes: Literal["x", "y", "xy"] = Field(default="xy", description="planes of these devices")
    values: dict[str, Number] = Field(description="values of the parameters, in their units")
    onset_s: Number = Field(
        default=None, description="time from the first reading to the onset [s]; null: always there"
    )
    elements: dict[str, Number] = Field(
        default_factory=dict,
        description="errors of single elements of the response, by the name of the other device "
        "[m/A]; empty for effects that do not act on single elements",
    )


class Cause(Part):
    """An effect that is named as a cause of the gap."""

    effect: str = Field(description="id of the effect, kebab-case")
    stage: Stage = Field(description="stage at which it acts")
    places: tuple[str, ...] = Field(description="names of the devices; empty for the whole ring")
    planes: Literal["x", "y", "xy"] = Field(default="xy", description="planes of these devices")
    parameters: dict[str, ParameterValue] = Field(
        default_factory=dict, description="estimated parameters, by name"
    )
    probability: Number = Field(
        description="calibrated probability of the effect or one of its `alternatives` [1]"
    )
    onset_s: Number = Field(
        default=None, description="time from the first reading to the onset [s]; null: always there"
    )
    alternatives: tuple[str, ...] = Field(
        default=(),
        description="ids of effects that the record cannot tell from it, that are the same on this "
        "ring, or that are the same fault with another course in time",
    )
    title: str = Field(default="", description="the effect in a few words")
    sentence: str = Field(default="", description="what an operator sees, why, and what to check")
    label: str = Field(default="", description="the places in words, such as `cells C03-C05`")
    places_within: tuple[str, ...] = Field(
        default=(),
        description="other places that the record cannot exclude",
    )
    evidence_nats: Number = Field(
        default=None,
        description="log evidence for this cause against the same answer without it, all other "
        "errors free [nats]",
    )
    scatter: bool = Field(
        default=False,
        description="whether `parameters` are standard deviations over all devices, each of which "
        "has an error of its own",
    )
    by_place: tuple[PlaceValues, ...] = Field(
        default=(),
        description="values of each device, as `effect.toml` has them; `parameters` are then those "
        "of the largest one, or their standard deviation; empty if all devices have the same",
    )


class GapPiece(Part):
    """A part of the gap: a frequency band or a time window."""

    label: str = Field(description="the part in words")
    start: Number = Field(default=None, description="lower edge [Hz or s]")
    stop: Number = Field(default=None, description="upper edge [Hz or s]")
    nats_per_tick: Number = Field(default=None, description="gap in this part [nats/tick]")


class Gap(Part):
    """How far the record is from the nominal model, in addition to noise and drift."""

    nats_per_tick: Number = Field(
        description="the gap: evidence for the causes per tick [nats/tick]"
    )
    low: Number = Field(description="lower end of the 90 % interval of `nats_per_tick`")
    high: Number = Field(description="upper end of the 90 % interval of `nats_per_tick`")
    um: Number = Field(
        description="rms that the causes add to the error of a prediction one row ahead [µm]"
    )
    um_low: Number = Field(default=None, description="lower end of the 90 % interval of `um`")
    um_high: Number = Field(default=None, description="upper end of the 90 % interval of `um`")
    floor_um: Number = Field(
        description="rms error of the prediction by noise and drift alone [µm]"
    )
    resolved: bool = Field(default=True, description="whether the interval excludes zero")
    by_stage: dict[str, Number] = Field(
        default_factory=dict,
        description="parts of the gap by stage, and the part `unexplained` [nats/tick]; they add "
        "up to the gap",
    )
    by_bpm: dict[str, Number] = Field(
        default_factory=dict,
        description="parts of the gap by BPM [nats/tick]; the parts by BPM, by mode, by band and "
        "by window each add up to the gap of the causes that have a course in time",
    )
    by_corrector: dict[str, Number] = Field(
        default_factory=dict,
        description="gain of log-likelihood by an error of each corrector alone [nats/tick]; these "
        "do not add up, because the columns of R overlap",
    )
    um_by_bpm: dict[str, Number] = Field(
        default_factory=dict,
        description="rms that the causes add to the error of a prediction one row ahead [µm]",
    )
    by_mode: Numbers = Field(
        default=(),
        description="parts of the gap by singular mode, the strongest first; the last is the part "
        "that no corrector reaches [nats/tick]",
    )
    by_band: tuple[GapPiece, ...] = Field(
        default=(), description="parts of the gap by frequency band [Hz]"
    )
    by_window: tuple[GapPiece, ...] = Field(
        default=(), description="parts of the gap by time window [s]"
    )
    floor_from: str = Field(
        default="", description="the data from which noise and drift were estimated"
    )


class Shrink(Part):
    """How much of the gap the causes remove, with the values of `effect.toml`."""

    nats: Number = Field(
        description="share of the gap in nats that is removed [1]; negative if the gap grows"
    )
    low: Number = Field(description="lower end of the 90 % interval of `nats`")
    high: Number = Field(description="upper end of the 90 % interval of `nats`")
    um: Number = Field(
        description="share of the rms error of a prediction, in addition to noise and drift, that "
        "is removed [1]; noise and drift come from the quietest windows, or from the reference"
    )
    um_low: Number = Field(default=None, description="lower end of the 90 % interval of `um`")
    um_high: Number = Field(default=None, description="upper end of the 90 % interval of `um`")
    held_out_ticks: int = Field(description="number of ticks on which it was measured")
    resolved: bool = Field(default=True, description="whether these ticks have a gap")
    on: str = Field(default="", description="which data: the later record, or the record itself")
    before_um: Number = Field(
        default=None,
        description="rms error in addition to noise and drift, of the nominal model [µm]",
    )
    after_um: Number = Field(default=None, description="the same of the model with the causes [µm]")


class Experiment(Part):
    """The experiment that would decide."""

    kind: str = Field(description="shaped-dither, amplitude-ladder, rf-step, read-only-test, …")
    text: str = Field(description="what to do, in one or two sentences")
    splits: tuple[str, ...] = Field(
        default=(), description="ids of the effects that it tells apart"
    )
    devices: tuple[str, ...] = Field(default=(), description="correctors or BPMs that it needs")
    modes: tuple[int, ...] = Field(default=(), description="singular modes that it excites, from 0")
    amplitude: Number = Field(default=None, description="largest change of a setpoint [A]")
    orbit_cost_um: Number = Field(default=None, description="rms of the orbit that it makes [µm]")
    minutes: Number = Field(
        default=None, description="beam time until 99 of 100 such experiments decide [min]"
    )
    separation_nats: Number = Field(default=None, description="expected evidence [nats]")
    limits: str = Field(default="", description="limits that it keeps")
    file: str = Field(default="", description="file to give to `orbitfb run --excite`")


class NotTested(Part):
    """An effect that this record cannot show."""

    effect: str = Field(description="id of the effect")
    reason: str = Field(description="why the record cannot show it")


class Detectable(Part):
    """The size of an effect that this record would have shown, at 5 standard deviations."""

    effect: str = Field(description="id of the effect")
    parameter: str = Field(description="name of the parameter")
    size: Number = Field(description="median over the places [`unit`]")
    unit: str = Field(description="unit of both sizes")
    best: Number = Field(default=None, description="size at the place that shows it best [`unit`]")


class Finding(Part):
    """A finding of the integrity screen. After a `failure` nothing was estimated."""

    check: str = Field(description="name of the check, kebab-case")
    severity: Severity = Field(description="how grave it is")
    devices: tuple[str, ...] = Field(default=(), description="devices concerned; empty: all")
    rows: tuple[int, int] | None = Field(
        default=None, description="first and last row concerned, from 0; null: all"
    )
    text: str = Field(description="what, where, what to do")
    effect: str = Field(default="", description="id of the effect that this proves; empty: none")


class Provenance(Part):
    """What one needs to get the same answer again."""

    data_sha256: str = Field(description="checksum of the record")
    seed: int = Field(description="seed of all random numbers")
    versions: dict[str, str] = Field(description="versions of orbitfb, python, numpy and scipy")
    source: str = Field(default="", description="the record, in words")
    reference_sha256: str = Field(default="", description="checksum of the reference record")
    reference_source: str = Field(default="", description="the reference record, in words")
    holdout_sha256: str = Field(default="", description="checksum of the later record")
    holdout_source: str = Field(default="", description="the later record, in words")
    model_sha256: str = Field(default="", description="checksum of the nominal response")
    library_sha256: str = Field(default="", description="checksum of the library of effects")
    ticks: int = Field(default=0, description="number of ticks in the record")
    bpms: int = Field(default=0, description="number of columns of BPMs")
    correctors: int = Field(default=0, description="number of columns of correctors")
    planes: str = Field(default="", description="planes of the record")
    period_s: Number = Field(default=None, description="time between two ticks [s]")
    reading_noise_um: Number = Field(default=None, description="rms noise of the readings [µm]")
    drift_um_per_tick: Number = Field(default=None, description="rms drift from tick to tick [µm]")
    gauge: str = Field(default="", description="how the common scale of all gains is fixed")
    thresholds: dict[str, Number] = Field(
        default_factory=dict, description="thresholds of the decision, by name"
    )
    seconds: Number = Field(default=None, description="how long the diagnosis took [s]")
