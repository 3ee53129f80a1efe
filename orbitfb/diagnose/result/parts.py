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
    at_bound: bool = Field(default=False, description="the fit ended at a bound: not to be trusted")
    meaning: str = Field(default="", description="what the value stands for, where it is a choice")


class PlaceValues(Part):
    """Devices of a cause that have the same values."""

    places: tuple[str, ...] = Field(description="names of the devices; empty for the whole ring")
    planes: Literal["x", "y", "xy"] = Field(default="xy", description="planes of these devices")
    values: dict[str, Number] = Field(description="of the parameters, in their units")
    onset_s: Number = Field(default=None, description="when it begins [s]; null: always there")
    elements: dict[str, Number] = Field(
        default_factory=dict,
        description="errors of single elements of the response, by the name of the other device "
        "[m/A]; empty of an effect that is not told so",
    )


class Cause(Part):
    """An effect that is named as a cause of the gap."""

    effect: str = Field(description="id of the effect, kebab-case")
    stage: Stage = Field(description="link of the chain that it changes")
    places: tuple[str, ...] = Field(description="names of the devices; empty for the whole ring")
    planes: Literal["x", "y", "xy"] = Field(default="xy", description="planes of these devices")
    parameters: dict[str, ParameterValue] = Field(default_factory=dict)
    probability: Number = Field(description="calibrated probability of its class [1]")
    onset_s: Number = Field(
        default=None, description="when it begins, since the first reading [s]; null: always there"
    )
    alternatives: tuple[str, ...] = Field(
        default=(),
        description="ids of its class: what the record cannot exclude, what amounts to it here, or "
        "its fault with another course in time",
    )
    title: str = Field(default="", description="the effect in a few words")
    sentence: str = Field(default="", description="what it means to an operator")
    label: str = Field(default="", description="the places in words, such as `cells C03-C05`")
    places_within: tuple[str, ...] = Field(
        default=(),
        description="other places that the record cannot exclude",
    )
    evidence_nats: Number = Field(
        default=None,
        description="log evidence of the record with it over that without it, all other errors "
        "free [nats]",
    )
    scatter: bool = Field(
        default=False,
        description="`parameters` are the standard deviation over all devices: every one is off by "
        "an amount of its own",
    )
    by_place: tuple[PlaceValues, ...] = Field(
        default=(),
        description="values of every device, where they differ: what `effect.toml` holds; "
        "`parameters` are then those of the largest one, or their scatter; empty: all the same",
    )


class GapPiece(Part):
    """A piece of the gap: a band, a window."""

    label: str
    start: Number = Field(default=None, description="lower edge, in the unit of the partition")
    stop: Number = Field(default=None, description="upper edge, in the unit of the partition")
    nats_per_tick: Number = Field(default=None, description="its part of the gap [nats/tick]")


class Gap(Part):
    """How far the record is from the nominal model, above the floor of the noise."""

    nats_per_tick: Number = Field(description="the gap [nats/tick], the floor subtracted")
    low: Number = Field(description="lower end of the 90 % interval of nats_per_tick")
    high: Number = Field(description="upper end of the 90 % interval of nats_per_tick")
    um: Number = Field(
        description="rms of what the causes add to the error of a prediction one row ahead [µm]"
    )
    um_low: Number = Field(default=None, description="lower end of the 90 % interval of um")
    um_high: Number = Field(default=None, description="upper end of the 90 % interval of um")
    floor_um: Number = Field(description="rms that noise and drift alone would leave [µm]")
    resolved: bool = Field(default=True, description="whether the interval leaves out zero")
    by_stage: dict[str, Number] = Field(
        default_factory=dict,
        description="parts of the gap by stage, and what is `unexplained` [nats/tick]; they add up "
        "to the whole",
    )
    by_bpm: dict[str, Number] = Field(
        default_factory=dict,
        description="parts of the gap by BPM [nats/tick]; by BPM, mode, band and window they add "
        "up to the part of the causes that have a course in time",
    )
    by_corrector: dict[str, Number] = Field(
        default_factory=dict,
        description="gain of log-likelihood by an error of each corrector alone [nats/tick]; a "
        "score map: the columns of R overlap, so it does not add up",
    )
    um_by_bpm: dict[str, Number] = Field(
        default_factory=dict,
        description="rms of what the causes add to the error of a prediction one row ahead [µm]",
    )
    by_mode: Numbers = Field(
        default=(),
        description="parts by singular mode, strongest first, and last by what no corrector "
        "reaches [nats/tick]; they add up",
    )
    by_band: tuple[GapPiece, ...] = Field(default=(), description="by frequency band [Hz]")
    by_window: tuple[GapPiece, ...] = Field(default=(), description="by time window [s]")
    floor_from: str = Field(default="", description="where the floor of the noise comes from")


class Shrink(Part):
    """How much of the gap is gone with what is named, and written to `effect.toml`."""

    nats: Number = Field(description="share of the gap in nats that is gone [1]; may be negative")
    low: Number = Field(description="lower end of the 90 % interval of nats")
    high: Number = Field(description="upper end of the 90 % interval of nats")
    um: Number = Field(
        description="share of the rms error of a prediction, beyond what noise and drift alone "
        "leave, that is gone [1]; the lowest windows of the record, or the reference, tell these"
    )
    um_low: Number = Field(default=None, description="lower end of the 90 % interval of um")
    um_high: Number = Field(default=None, description="upper end of the 90 % interval of um")
    held_out_ticks: int = Field(description="ticks that it is told on")
    resolved: bool = Field(default=True, description="whether there is any gap on these ticks")
    on: str = Field(default="", description="which data: the later record, the record itself")
    before_um: Number = Field(
        default=None, description="rms error beyond noise and drift, nominal model [µm]"
    )
    after_um: Number = Field(default=None, description="the same with the causes [µm]")


class Experiment(Part):
    """What to do next, when the record cannot decide."""

    kind: str = Field(description="shaped-dither, amplitude-ladder, rf-step, read-only-test, …")
    text: str = Field(description="what to do, in one or two sentences")
    splits: tuple[str, ...] = Field(default=(), description="effects that it tells apart")
    devices: tuple[str, ...] = Field(default=(), description="correctors or BPMs it needs")
    modes: tuple[int, ...] = Field(default=(), description="singular modes it excites, from 0")
    amplitude: Number = Field(default=None, description="largest change of a setpoint [A]")
    orbit_cost_um: Number = Field(default=None, description="rms of the orbit it makes [µm]")
    minutes: Number = Field(default=None, description="beam time for 99 % discrimination [min]")
    separation_nats: Number = Field(default=None, description="expected separation [nats]")
    limits: str = Field(default="", description="limits that hold it")
    file: str = Field(default="", description="file for `orbitfb run --excite`")


class NotTested(Part):
    """An effect that this record cannot show."""

    effect: str
    reason: str


class Detectable(Part):
    """What size of an effect this record would have shown (5 sigma)."""

    effect: str
    parameter: str
    size: Number = Field(description="median over the places [unit]")
    unit: str
    best: Number = Field(default=None, description="at the place where it shows best [unit]")


class Finding(Part):
    """Something that the integrity screen found; `failure` means that nothing was estimated."""

    check: str = Field(description="which check, kebab-case")
    severity: Severity
    devices: tuple[str, ...] = ()
    rows: tuple[int, int] | None = Field(
        default=None, description="first and last row concerned, from 0; null: all"
    )
    text: str = Field(description="what, where, what to do")
    effect: str = Field(default="", description="id of the effect that it proves; empty: none")


class Provenance(Part):
    """What is needed to get the same answer again."""

    data_sha256: str = Field(description="of the record")
    seed: int
    versions: dict[str, str] = Field(description="orbitfb, python, numpy, scipy")
    source: str = Field(default="", description="the record, for people")
    reference_sha256: str = ""
    reference_source: str = ""
    holdout_sha256: str = ""
    holdout_source: str = ""
    model_sha256: str = Field(default="", description="of the nominal response")
    library_sha256: str = Field(default="", description="of the library of effects")
    ticks: int = 0
    bpms: int = 0
    correctors: int = 0
    planes: str = ""
    period_s: Number = None
    reading_noise_um: Number = None
    drift_um_per_tick: Number = None
    gauge: str = Field(default="", description="how the common scale of the gains is fixed")
    thresholds: dict[str, Number] = Field(default_factory=dict)
    seconds: Number = Field(default=None, description="how long the diagnosis took [s]")
