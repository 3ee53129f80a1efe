"""Configuration of the law that learns while it acts."""

from pydantic import Field

from orbitfb.core.settings import Settings
from orbitfb.estimation.recursive.settings import CautionSettings, RecursiveSettings


class TrackingSettings(RecursiveSettings):
    """What a loop knows of a ring beforehand. [R] is m/A.

    The drifts are those of the preset `strong`: a random walk of 10,000 ticks ends as far away,
    √2 · 3 µm/A an element and 3 % a gain. In a straight line that is 0.42 nm/A a tick, of which
    2.4 A make the white part of the creep.
    """

    ground: float = Field(
        default=0.04e-6,
        ge=0.0,
        description="Motion of the orbit per tick, as kicks along the ring make it, rms [m].",
    )
    prior_entry: float = Field(
        default=1e-6, ge=0.0, description="Error of an element of the first R̂, rms [R]."
    )
    prior_relative: float = Field(
        default=0.02,
        ge=0.0,
        description="Errors of the gains of BPMs and correctors in the first R̂, rms [1].",
    )
    drift_entry: float = Field(
        default=4.2e-8, ge=0.0, description="Drift of an element of R in √tick, rms [R]."
    )
    drift_relative: float = Field(
        default=3e-4,
        ge=0.0,
        description="Drift of the gains of BPMs and correctors in √tick, rms [1].",
    )
    creep: float = Field(
        default=0.02e-6,
        ge=0.0,
        description="Creep of the orbit that a drift of R makes of setpoints that stay, rms over "
        "the modes, each in proportion to its singular value [m/tick]; 0: no such coefficient.",
    )
    creep_held: float | None = Field(
        default=2.4,
        gt=0.0,
        description="Norm of the currents for which this creep is told, those of before the loop "
        "closed; it grows and turns with what is held since [A]. Unset: it is the same whatever "
        "is held.",
    )
    rf_creep: float = Field(
        default=0.02,
        ge=0.0,
        description="The part of the creep that an energy which drifts makes, where the RF column "
        "is tracked, as a drift of the frequency would, rms [Hz/tick].",
    )


class AdaptiveSettings(Settings):
    """Configuration of the law that learns while it acts.

    The caution was chosen with `benchmarks.promotions --minutes 17 --drift strong --rule now
    --policy adaptive --caution C` on seeds 62, 71, 91 and 98, when the gain was made every ten
    ticks: the true orbit over that of the law which is told R was 1.44 on average with 0.7, 1.18
    with 0.35, 1.16 with 0.2, 1.06 with 0.1 and 1.02 with 0.05; with 0.02 seed 62 rose from 1.23 to
    1.84.

    A mode whose response drifts through zero while it holds a current asks for ever more of it.
    The caution does not help, for that response is known well; the price of a held current does.
    It is by hand, of 0, 0.03, 0.06 and 0.1 µm/A², so that setpoints stay far from their limit of
    17.5 A: with `benchmarks.promotions --minutes 30 --drift strong --drift-ticks 18000 --rule now
    --policy adaptive` the largest setpoint of seeds 413, 423 and 426 is 21, 116 and 24 A without
    price and regularisation, and 6.8, 10 and 8.2 A with them. The regularisation is the price of
    what holds nothing yet: that of half an ampere.
    """

    tracking: TrackingSettings = Field(
        default=TrackingSettings(), description="The estimate of R at every tick."
    )
    track_rf: bool = Field(
        default=False,
        description="Whether the RF column is tracked beside R; otherwise it is left to refits of "
        "the learner.",
    )
    caution: CautionSettings = Field(
        default=CautionSettings(period=30, caution=0.1, regularisation=3e-8, price=6e-8),
        description="How the gain is made of it, and when.",
    )
