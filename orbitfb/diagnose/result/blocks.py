"""The parts of a diagnosis that its report draws; any of them may be missing."""

from pydantic import Field

from orbitfb.diagnose.result.values import Number, Numbers, Part, Table


class Geometry(Part):
    """Where the devices stand, for pictures; empty where it is not known."""

    bpms: dict[str, Number] = Field(default_factory=dict, description="by key of by_bpm [m]")
    correctors: dict[str, Number] = Field(
        default_factory=dict, description="by key of by_corrector [m]"
    )
    sectors_m: Numbers = Field(default=(), description="where sectors begin [m]")
    sector_names: tuple[str, ...] = ()
    circumference_m: Number = None


class KStep(Part):
    """Rms error of a prediction k rows ahead, from the logged setpoints [µm]."""

    k: int
    nominal_um: Number = Field(description="of the nominal model [µm]")
    effect_um: Number = Field(default=None, description="with the causes in the model [µm]")
    floor_um: Number = Field(default=None, description="that noise and drift alone leave [µm]")


class ClosedLoop(Part):
    """The orbit about its reference: measured, and the loop run anew on the record's noise."""

    without_um: Number = Field(
        description="rms that the loop would reach without the causes [µm]; null: not predicted"
    )
    with_um: Number = Field(
        default=None,
        description="the same with the causes: where it is not what was measured, the loop's law "
        "is not known well enough [µm]",
    )
    measured_um: Number = Field(description="rms of the readings [µm]")
    measured_low: Number = None
    measured_high: Number = None
    radius_without: Number = Field(default=None, description="spectral radius of the loop, nominal")
    radius_with: Number = Field(
        default=None,
        description="spectral radius with the causes, where they are gains of correctors",
    )
    frequency_hz: Numbers = Field(default=(), description="of the spectra [Hz]")
    psd_measured: Numbers = Field(
        default=(),
        description="of the same readings, mean over the BPMs [µm²/Hz]",
    )
    psd_without: Numbers = Field(default=(), description="without the causes [µm²/Hz]")
    note: str = Field(default="", description="why a prediction is missing")


class TournamentRow(Part):
    """A kind of effect at its best places."""

    effect: str
    places: str = Field(default="", description="in words")
    nats: Number = Field(
        description="log evidence over no effect, less what the choice of places costs; 0: the "
        "record shows nothing of it [nats]"
    )
    probability: Number = Field(default=None, description="that it is the first cause [1]")
    members: tuple[str, ...] = Field(default=(), description="ids of its class, itself included")
    accepted: bool = False


class Tournament(Part):
    """All kinds of effects against each other."""

    rows: tuple[TournamentRow, ...] = ()
    free_nats: Number = Field(
        default=None,
        description="what an unknown law of the best single device would explain [nats]",
    )


class WaterfallStep(Part):
    """What is left of the gap after one more cause, in the order in which they were found."""

    label: str
    left_nats: Number = Field(description="gap that is left [nats/tick]")


class GoodnessTest(Part):
    """A test of what is left when all causes are in the model."""

    name: str
    value: Number
    limit: Number
    flagged: bool
    note: str = ""
    nats: Number = Field(default=0.0, description="what a model that has it would gain, roughly")
    places: tuple[str, ...] = Field(default=(), description="devices that it speaks of")


class AmbiguousSet(Part):
    """Effects that this record cannot tell apart."""

    effects: tuple[str, ...] = Field(
        description="`no_gap` among them: there may be none of them either"
    )
    why: str = ""
    splits: str = Field(default="", description="what would tell them apart")


class Fingerprint(Part):
    """The slice of the record that shows an effect best: data, nominal model, mended model."""

    title: str
    x_label: str
    y_label: str
    x: Numbers = Field(description="mean of every bin")
    measured: Numbers = Field(description="what the model without it leaves, mean of the bin")
    nominal: Numbers = Field(default=(), description="what the model without the cause expects")
    refit: Numbers = Field(default=(), description="what the cause expects there")
    error: Numbers = Field(default=(), description="standard error of `measured`")


class ScoreRow(Part):
    """Gain of log-likelihood by one effect of a stage at each place, on the nominal model."""

    stage: str
    effect: str = Field(
        default="", description="a cause, or the best of the tournament with places"
    )
    gain: Numbers = Field(description="nats, at each place")
    s_m: Numbers = Field(default=(), description="position of each place [m]; empty: not known")
    names: tuple[str, ...] = ()
    fitted: tuple[int, ...] = Field(default=(), description="indices of the places named")
    within: tuple[int, ...] = Field(default=(), description="indices that cannot be excluded")


class ScoreMap(Part):
    """Score of every stage over the ring."""

    rows: tuple[ScoreRow, ...] = ()
    threshold_nats: Number = Field(
        default=None,
        description="what chance reaches at the best place once in 100 records",
    )


class LagProfile(Part):
    """Answer to a change of the setpoints by its age, beyond what the model expects [1]."""

    lags: tuple[int, ...] = Field(description="rows since the change; 0: that of the reading")
    slope: Numbers = Field(description="nominal model, share of the change; 0 where it is right")
    low: Numbers = ()
    high: Numbers = ()
    refit: Numbers = Field(default=(), description="the same with the causes in the model")


class Identifiability(Part):
    """Which effects look alike in this record."""

    effects: tuple[str, ...] = ()
    cosine: Table = Field(default=(), description="cosine of the changes of the prediction [1]")
    degenerate: tuple[str, ...] = Field(default=(), description="in words, a sentence each")


class Unknown(Part):
    """What is known of a gap that no effect of the library explains."""

    places: tuple[str, ...] = Field(default=(), description="devices where the gap sits")
    text: str = Field(default="", description="its fingerprint in words")
    nearest: str = Field(default="", description="id of the nearest effect of the library")
    nearest_nats: Number = None
    explained: Number = Field(
        default=None, description="share of the gap in nats that the causes explain [1]"
    )


class Audit(Part):
    """What is left when all causes are in the model."""

    tests: tuple[GoodnessTest, ...] = ()
    quantiles: Numbers = Field(
        default=(), description="of the whitened innovation, sorted; thinned to some hundreds"
    )
    autocorrelation: Numbers = Field(default=(), description="lags 1, 2, … [1]")
    autocorrelation_limit: Number = None
    worst_channels: dict[str, Number] = Field(
        default_factory=dict, description="mean square of the whitened innovation [1]"
    )
    worst_ticks: dict[str, Number] = Field(
        default_factory=dict, description="by row, mean square of the whitened innovation [1]"
    )
