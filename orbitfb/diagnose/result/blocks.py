"""The parts of a diagnosis that the report draws. Each of them may be missing."""

from pydantic import Field

from orbitfb.diagnose.result.values import Number, Numbers, Part, Table


class Geometry(Part):
    """Positions of the devices along the ring, for pictures; empty if they are not known."""

    bpms: dict[str, Number] = Field(
        default_factory=dict, description="position of each BPM, by the keys of `by_bpm` [m]"
    )
    correctors: dict[str, Number] = Field(
        default_factory=dict,
        description="position of each corrector, by the keys of `by_corrector` [m]",
    )
    sectors_m: Numbers = Field(default=(), description="positions at which sectors begin [m]")
    sector_names: tuple[str, ...] = Field(default=(), description="names of these sectors")
    circumference_m: Number = Field(default=None, description="circumference of the ring [m]")


class KStep(Part):
    """Rms error of a prediction k rows ahead, made from the recorded setpoints."""

    k: int = Field(description="number of rows")
    nominal_um: Number = Field(description="error of the nominal model [µm]")
    effect_um: Number = Field(default=None, description="error of the model with the causes [µm]")
    floor_um: Number = Field(default=None, description="error by noise and drift alone [µm]")


class ClosedLoop(Part):
    """Orbit error in closed loop: as measured, and as simulated with the noise of the record."""

    without_um: Number = Field(
        description="rms that the loop would reach without the causes [µm]; null: not predicted"
    )
    with_um: Number = Field(
        default=None,
        description="simulated rms with the causes [µm]; if it differs from `measured_um`, the law "
        "of the loop is not known well enough",
    )
    measured_um: Number = Field(description="rms of the readings [µm]")
    measured_low: Number = Field(default=None, description="lower end of its 90 % interval [µm]")
    measured_high: Number = Field(default=None, description="upper end of its 90 % interval [µm]")
    radius_without: Number = Field(
        default=None, description="spectral radius of the loop with the nominal model [1]"
    )
    radius_with: Number = Field(
        default=None,
        description="spectral radius of the loop with the causes [1]; null unless they are gains",
    )
    frequency_hz: Numbers = Field(default=(), description="frequencies of the spectra [Hz]")
    psd_measured: Numbers = Field(
        default=(),
        description="measured power spectral density, mean over the BPMs [µm²/Hz]",
    )
    psd_without: Numbers = Field(
        default=(), description="the same, predicted without the causes [µm²/Hz]"
    )
    note: str = Field(default="", description="the reason why a prediction is missing")


class TournamentRow(Part):
    """One effect at its best places."""

    effect: str = Field(description="id of the effect")
    places: str = Field(default="", description="the places in words")
    nats: Number = Field(
        description="log evidence for the effect against no effect, less the cost of choosing the "
        "places [nats]; 0: the record shows no trace of it"
    )
    probability: Number = Field(
        default=None, description="probability that this is the first cause [1]"
    )
    members: tuple[str, ...] = Field(
        default=(),
        description="ids of the effects that the record cannot tell from it, itself included",
    )
    accepted: bool = Field(default=False, description="whether it is among the causes")


class Tournament(Part):
    """All effects compared with each other."""

    rows: tuple[TournamentRow, ...] = Field(default=(), description="one row per effect")
    free_nats: Number = Field(
        default=None,
        description="evidence for the best unknown law, of devices or of a place that kicks [nats]",
    )


class WaterfallStep(Part):
    """The rest of the gap after one more cause, in the order in which causes were found."""

    label: str = Field(description="the cause in words")
    left_nats: Number = Field(description="the rest of the gap [nats/tick]")


class GoodnessTest(Part):
    """A test of the residuals of the model with all causes."""

    name: str = Field(description="name of the test")
    value: Number = Field(description="its result")
    limit: Number = Field(description="limit of the result")
    flagged: bool = Field(description="whether the result is beyond the limit")
    note: str = Field(default="", description="the result in words")
    nats: Number = Field(
        default=0.0, description="rough evidence that a better model would gain [nats]"
    )
    places: tuple[str, ...] = Field(default=(), description="devices that the test concerns")


class AmbiguousSet(Part):
    """Effects that this record cannot tell apart."""

    effects: tuple[str, ...] = Field(
        description="ids of the effects; with `no_gap` among them there may be no effect at all"
    )
    why: str = Field(default="", description="the reason in words")
    splits: str = Field(default="", description="what would tell them apart")


class Fingerprint(Part):
    """The picture that shows an effect best: data, nominal model, and model with the cause."""

    title: str = Field(description="title of the picture")
    x_label: str = Field(description="label of the horizontal axis")
    y_label: str = Field(description="label of the vertical axis")
    x: Numbers = Field(description="mean of each bin")
    measured: Numbers = Field(
        description="residual of the model without the cause, mean of each bin"
    )
    nominal: Numbers = Field(default=(), description="prediction of the model without the cause")
    refit: Numbers = Field(default=(), description="prediction of the cause")
    error: Numbers = Field(default=(), description="standard error of `measured`")


class ScoreRow(Part):
    """Gain of log-likelihood by one effect at each place, added to the nominal model."""

    stage: str = Field(description="stage of the effect")
    effect: str = Field(
        default="", description="id of a cause, or of the best effect of the stage that has places"
    )
    gain: Numbers = Field(description="gain at each place [nats]")
    s_m: Numbers = Field(default=(), description="position of each place [m]; empty if not known")
    names: tuple[str, ...] = Field(default=(), description="name of each place")
    fitted: tuple[int, ...] = Field(default=(), description="indices of the places of the cause")
    within: tuple[int, ...] = Field(
        default=(), description="indices of places that cannot be excluded"
    )


class ScoreMap(Part):
    """Scores along the ring."""

    rows: tuple[ScoreRow, ...] = Field(default=(), description="one row per stage")
    threshold_nats: Number = Field(
        default=None,
        description="score that the best place reaches by chance in one of 100 records [nats]",
    )


class LagProfile(Part):
    """Response to a change of the setpoints, in addition to that of the model, by its age."""

    lags: tuple[int, ...] = Field(description="rows since the change; 0 is the row of the reading")
    slope: Numbers = Field(
        description="additional response, as a share of the change [1]; 0 if the model is right"
    )
    low: Numbers = Field(default=(), description="lower ends of the 90 % intervals of `slope`")
    high: Numbers = Field(default=(), description="upper ends of the 90 % intervals of `slope`")
    refit: Numbers = Field(default=(), description="the same for the model with the causes")


class Identifiability(Part):
    """Effects that look alike in this record."""

    effects: tuple[str, ...] = Field(default=(), description="ids of the effects")
    cosine: Table = Field(
        default=(),
        description="cosine between what two effects add to the prediction [1]; 1: alike",
    )
    degenerate: tuple[str, ...] = Field(default=(), description="a sentence for each alike pair")


class Unknown(Part):
    """A gap that no effect of the library explains."""

    places: tuple[str, ...] = Field(default=(), description="devices at which the gap is")
    text: str = Field(default="", description="what the gap looks like, in words")
    nearest: str = Field(default="", description="id of the nearest effect of the library")
    nearest_nats: Number = Field(default=None, description="evidence for that effect [nats]")
    explained: Number = Field(
        default=None, description="share of the gap that the causes explain [1]"
    )


class Audit(Part):
    """Tests of the residuals of the model with all causes."""

    tests: tuple[GoodnessTest, ...] = Field(default=(), description="the tests")
    quantiles: Numbers = Field(
        default=(), description="some hundred quantiles of the whitened prediction errors, sorted"
    )
    autocorrelation: Numbers = Field(
        default=(), description="autocorrelation of the prediction errors at lags 1, 2, … [1]"
    )
    autocorrelation_limit: Number = Field(
        default=None, description="limit of the autocorrelation [1]"
    )
    worst_channels: dict[str, Number] = Field(
        default_factory=dict,
        description="mean square of the whitened prediction errors, by BPM [1]; 1 is expected",
    )
    worst_ticks: dict[str, Number] = Field(
        default_factory=dict,
        description="mean square of the whitened prediction errors, by row [1]; 1 is expected",
    )
