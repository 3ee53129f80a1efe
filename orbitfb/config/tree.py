"""The configuration of the whole service: one frozen tree.

`load` composes it from file, environment and options.
"""

from pathlib import Path
from typing import Literal

from pydantic import Field

from orbitfb.config.defaults import DATA_DIRECTORY
from orbitfb.core.settings import Settings
from orbitfb.diagnose.settings import DiagnoseSettings
from orbitfb.effects.settings import EffectSettings
from orbitfb.epics.fast_reference import FastFeedbackSettings
from orbitfb.epics.lease.lease import LeaseSettings
from orbitfb.epics.settings import EpicsSettings
from orbitfb.history.settings import ArchiveSettings
from orbitfb.learn.settings import LearnSettings
from orbitfb.loop.correction.settings import CorrectionSettings
from orbitfb.loop.excitation.dither import DitherSettings
from orbitfb.loop.settings import LoopSettings
from orbitfb.measure.settings import MeasureSettings
from orbitfb.models.forward.settings import ForwardSettings
from orbitfb.observe.settings import ObserveSettings
from orbitfb.page.settings import WebSettings
from orbitfb.panel.settings import PanelSettings
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import PlantSettings
from orbitfb.policies.masking import MaskSettings
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.training.supervised_settings import SupervisedSettings
from orbitfb.policies.training.trajectory_settings import StructuredSettings, TrajectorySettings
from orbitfb.postmortem.settings import PostMortemSettings
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings
from orbitfb.safety.rf_settings import RfSettings
from orbitfb.sim.settings import SimSettings


class RingSettings(Settings):
    """Which ring is under feedback."""

    places: Path | None = Field(
        default=None, description="Places table (CSV); none: the default ring."
    )
    parameters: Path | None = Field(
        default=None, description="Ring parameters (JSON); none: the default ring."
    )
    planes: Planes = Field(default="x", description="Planes under feedback: x, y or xy.")
    response: Path | None = Field(
        default=None,
        description="Measured response matrix, as `orbitfb measure-response` writes it; none: that "
        "of the optics.",
    )

    def load(self) -> Ring:
        """Read the ring that these settings name."""
        return Ring.load(self.places, self.parameters)


class TrainSettings(Settings):
    """How `orbitfb train` trains."""

    samples: int = Field(
        default=8,
        ge=0,
        description="Response matrices drawn from the posterior for an iteration, when an archive "
        "is given [1]; 0: R̂ alone.",
    )
    supervised: SupervisedSettings = Field(
        default=SupervisedSettings(), description="Training on labels."
    )
    begin: Literal["random", "embedded"] = Field(
        default="embedded",
        description="What a trajectory training begins with: random weights (the paper), or the "
        "modal law written into the network.",
    )
    trajectory: TrajectorySettings = Field(
        default=TrajectorySettings(
            trained="output",
            horizon=10,
            loss="log",
            smallest_amplitude=0.05e-6,
            reading_noise=0.2e-6,
            kick_noise=0.04e-6,
            learning_rate=3e-4,
            final_learning_rate=3e-5,
        ),
        description="Training of a network through the model; the defaults are for a beginning "
        "with the embedded law.",
    )
    structured: StructuredSettings = Field(
        default=StructuredSettings(), description="Training of the modal law through the model."
    )
    forward: ForwardSettings = Field(
        default=ForwardSettings(), description="Training of the forward net."
    )


class HistorySettings(Settings):
    """What is kept of the transitions."""

    capacity: int = Field(default=20_000, ge=100, description="Ticks kept in memory.")
    archive: ArchiveSettings = Field(default=ArchiveSettings(), description="The archive on disk.")


class AppConfig(Settings):
    """Everything that can be configured."""

    data_directory: Path = Field(
        default=Path(DATA_DIRECTORY),
        validate_default=False,  # it is a path already, where a file has text
        description="Where policies, archive and log are kept.",
    )
    seed: int = Field(
        default=1,
        ge=0,
        description="Seed of the simulated ring, of test excitations and of the dither.",
    )
    policies_kept: int = Field(
        default=100,
        ge=2,
        description="Newest promotions of the learner, and last ones in force, that are kept; "
        "what was trained, imported, measured or activated is never removed.",
    )
    policy: PolicySettings = Field(
        default=PolicySettings(),
        description="The policy that runs, and the kind that every refit builds.",
    )
    masks: MaskSettings = Field(
        default=MaskSettings(), description="BPMs and correctors that are left out."
    )
    ring: RingSettings = Field(default=RingSettings(), description="The ring.")
    loop: LoopSettings = Field(default=LoopSettings(), description="The loop.")
    correction: CorrectionSettings = Field(
        default=CorrectionSettings(), description="Corrections of an open loop by hand."
    )
    dither: DitherSettings = Field(default=DitherSettings(), description="The dither.")
    limits: LimitSettings = Field(default=LimitSettings(), description="Limits of a write.")
    interlocks: InterlockSettings = Field(
        default=InterlockSettings(), description="What holds or trips the loop."
    )
    rf: RfSettings = Field(
        default=RfSettings(), description="The RF frequency, that follows the energy."
    )
    fast_feedback: FastFeedbackSettings = Field(
        default=FastFeedbackSettings(),
        description="A fast feedback that is handed our reference while it is closed.",
    )
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")
    diagnose: DiagnoseSettings = Field(
        default=DiagnoseSettings(), description="Diagnosis beside the loop."
    )
    measure: MeasureSettings = Field(
        default=MeasureSettings(), description="The command measure-response."
    )
    train: TrainSettings = Field(default=TrainSettings(), description="The command train.")
    history: HistorySettings = Field(
        default=HistorySettings(), description="Transitions in memory and on disk."
    )
    postmortem: PostMortemSettings = Field(
        default=PostMortemSettings(), description="What is kept of a trip."
    )
    observe: ObserveSettings = Field(
        default=ObserveSettings(), description="Metrics, health and logs."
    )
    web: WebSettings = Field(default=WebSettings(), description="The operator page.")
    panel: PanelSettings = Field(default=PanelSettings(), description="The loop's own PVs.")
    lease: LeaseSettings = Field(
        default=LeaseSettings(),
        description="Which of several controllers may write to the machine.",
    )
    epics: EpicsSettings = Field(default=EpicsSettings(), description="Channel Access.")
    sim: SimSettings = Field(default=SimSettings(), description="The soft IOC.")
    plant: PlantSettings = Field(
        default=PlantSettings(), description="The simulated ring behind the soft IOC."
    )
    effect: tuple[EffectSettings, ...] = Field(
        default=(),
        description="Physical effects that are added to the simulated ring; a table `effect` each.",
    )
