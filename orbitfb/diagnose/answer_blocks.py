"""The parts of a diagnosis that its report draws; any of them may be missing."""

from pydantic import Field

from orbitfb.diagnose.answer_values import Number, Numbers, Part, Table


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
    """Excess rms of a prediction k ticks ahead."""

    k: int
    nominal_um: Number
    nominal_low: Number = None
    nominal_high: Number = None
    effect_um: Number = Field(default=None, description="with the causes in the model [µm]")
    effect_low: Number = None
    effect_high: Number = None
    competitor_um: Number = Field(default=None, description="with a refitted R [µm]")
    net_um: Number = Field(default=None, description="with the forward net [µm]")
    floor_um: Number = None
    resolved: bool = Field(default=True, description="whether the nominal excess is resolved")


class ClosedLoop(Part):
    """What the loop does: predicted without and with the causes, beside what was measured."""

    without_um: Number = Field(
        description="rms of the orbit about its reference, simulated loop of the nominal model [µm]"
    )
    with_um: Number = Field(default=None, description="the same with the causes [µm]")
    with_low: Number = Field(
        default=None,
        description="with the causes, 90 % of records of this length are above: their noise alone",
    )
    with_high: Number = Field(default=None, description="the same, 90 % are below")
    measured_um: Number = Field(description="the same of the readings [µm]")
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
    psd_without: Numbers = Field(default=(), description="predicted, nominal model [µm²/Hz]")
    psd_with: Numbers = Field(default=(), description="predicted with the causes [µm²/Hz]")
    note: str = Field(default="", description="why a prediction is missing")


class TournamentRow(Part):
    """A kind of effect at its best places, scored on held-out ticks."""

    effect: str
    places: str = Field(default="", description="in words")
    nats: Number = Field(description="gain of log-likelihood on held-out ticks [nats]")
    low: Number = None
    high: Number = None
    probability: Number = Field(default=None, description="of its class [1]")
    members: tuple[str, ...] = Field(default=(), description="ids of its class, itself included")
    accepted: bool = False


class Tournament(Part):
    """All kinds of effects against each other."""

    rows: tuple[TournamentRow, ...] = ()
    ceiling_nats: Number = Field(
        default=None,
        description="what the causes gain on held-out ticks and a model of any kind beyond them; "
        "null where nothing beyond them is resolved",
    )


class WaterfallStep(Part):
    """What is left of the gap after one more cause, in the order in which they were found."""

    label: str
    fit: Number = Field(default=None, description="gap left, data of the fit [nats/tick]")
    held_out: Number = Field(
        default=None, description="gap left, data used for nothing else [nats/tick]"
    )


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
        default="", description="a cause; the best of the tournament, or a plain one, if none is"
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
    """Slope of the innovation on R·Δu of earlier ticks; lag 1 is that of the nominal loop."""

    lags: tuple[int, ...]
    slope: Numbers
    low: Numbers = ()
    high: Numbers = ()
    refit: Numbers = Field(default=(), description="the same of the mended model's innovation")


class HeatMap(Part):
    """Two-dimensional map: BPM × frequency, corrector × lag, Fisher cosines."""

    title: str
    row_label: str
    column_label: str
    values: Table
    unit: str = ""
    row_names: tuple[str, ...] = ()
    column_names: tuple[str, ...] = ()
    columns: Numbers = Field(default=(), description="values of the columns where they are numbers")
    signed: bool = Field(default=False, description="whether zero is the middle of the colours")


class Identifiability(Part):
    """Which effects look alike in this record."""

    effects: tuple[str, ...] = ()
    cosine: Table = Field(default=(), description="cosine of the changes of the prediction [1]")
    degenerate: tuple[str, ...] = Field(default=(), description="in words, a sentence each")


class Unknown(Part):
    """What is known of a gap that no effect of the library explains."""

    stages: dict[str, Number] = Field(default_factory=dict, description="probability by stage [1]")
    places: tuple[str, ...] = Field(default=(), description="devices where the gap sits")
    text: str = Field(default="", description="its fingerprint in words")
    nearest: str = Field(default="", description="id of the nearest effect of the library")
    nearest_nats: Number = None
    explained: Number = Field(default=None, description="share of the ceiling explained [1]")


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
    sensitivity: tuple[str, ...] = Field(
        default=(), description="what changes with priors, splits and levels, a sentence each"
    )
