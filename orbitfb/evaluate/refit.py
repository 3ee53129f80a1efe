"""What refits are worth: four loops on the same ring, noise and drift.

- `told`: told the true R_t, the bound;
- `frozen`: keeps the R that it began with;
- `naive`: puts the naive least squares in force again and again;
- `ours`: the learner of this package with its judge; its roll-back belongs to the thread, which
  `orbitfb.evaluate.live` runs.

All have the same gain and λ. Without drift, `told` and `frozen` are one loop when they begin with
the true R.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from orbitfb.core.ports import Policy
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.settings import Settings
from orbitfb.core.signals import Vector
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings
from orbitfb.evaluate.simulate import ClosedLoop
from orbitfb.learn.builders import builder
from orbitfb.learn.learner import Learner
from orbitfb.learn.settings import LearnSettings
from orbitfb.models.identify import Identifier
from orbitfb.models.linear import excited_gain
from orbitfb.models.naive import naive_least_squares
from orbitfb.models.rows import select_rows
from orbitfb.physics.drift import DriftSettings
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.policies.settings import PolicySettings
from orbitfb.policies.svd import SvdPolicy, SvdSettings

LAWS = ("told", "frozen", "naive", "ours")
_LOOK = 20
_TOLERANCE = 1e-6


class RefitEvaluationSettings(Settings):
    """What to evaluate."""

    drift: Literal["none", "paper", "mild", "strong"] = Field(
        default="none", description="Drift of the ring over the whole run."
    )
    ticks: int = Field(default=4000, ge=600, description="Length of each run [ticks].")
    seed: int = Field(default=1, ge=0, description="Seed of ring, noise and drift.")
    planes: Literal["x", "y", "xy"] = Field(default="x", description="Planes under feedback.")
    bpm_noise: float = Field(
        default=0.2e-6, ge=0, description="White noise of every BPM reading, rms [m]."
    )
    start: Literal["true", "nominal", "drawn"] = Field(
        default="true",
        description="R̂ that all but `told` begin with: the true one, that of the optics, or the "
        "true one with an error drawn from the learner's prior.",
    )
    settle: int = Field(
        default=300, ge=50, description="Ticks until the loop is at its noise floor [ticks]."
    )
    naive_every: int = Field(
        default=500, ge=200, description="Ticks between two naive refits [ticks]."
    )
    effects: tuple[EffectSettings, ...] = Field(
        default=(), description="Effects that the ring has besides."
    )
    period: float = Field(default=0.1, gt=0, description="By which effects count time [s].")
    policy: SvdSettings = Field(default=SvdSettings(), description="Gain and λ of all the laws.")
    learn: LearnSettings = Field(default=LearnSettings(), description="The learner.")


@dataclass(frozen=True, slots=True)
class RefitResult:
    """What came out.

    Args:
        settings: What was asked for.
        figures: By name, SI; `evaluate_refit` says what each one means.
        true_rms: True orbit by law, each of shape (ticks,) [m].
        errors: Errors of R̂ in units of the stated uncertainty, shape (n, m) [1].
        reports: What the learner did.
    """

    settings: RefitEvaluationSettings
    figures: Mapping[str, float]
    true_rms: Mapping[str, Vector]
    errors: Vector
    reports: tuple[RefitReport, ...]


def evaluate_refit(
    settings: RefitEvaluationSettings, progress: Callable[[str], None] = lambda _: None
) -> RefitResult:
    """Run the four loops and compare them.

    Figures, with `second half` the last half of the run and R the true one at its end:

    - `rms_told`, `rms_frozen`, `rms_naive`, `rms_ours`: true orbit over the second half, rms [m];
    - `rms_ratio_frozen`, `rms_ratio_naive`, `rms_ratio_ours`: over `rms_told`;
    - `gain_ours`: slope of R̂ on R over the excited directions, trace(R̂MRᵀ) / trace(RMRᵀ), with M
      the second moment of the changes applied after `settle` in the loop `ours`;
    - `gain_naive`: the same slope for the naive least squares over the record of the loop `frozen`
      after `settle`; `gain_naive_expected`: 1 + r² trace(RK) / trace(RMRᵀ), r² the variance of
      the reading noise: what the noise on both sides must make of it (1/2 + 1/g for a loop
      with gain g in every mode and no disturbance);
    - `loop_gain_naive`: mean diagonal of R̂K of that estimate, and `loop_gain_naive_expected`:
      1 + g/2 with g the mean diagonal of RK (`loop_gain`); the same bias seen by the loop;
    - `normalised_error_ours`: rms error of R̂ in units of its stated standard deviation;
      `within_two_sigma_ours`: share of the errors below two of them (0.954 if they are right);
    - `refits`, `promoted`, `refit_seconds_max` of the loop `ours`.

    Args:
        settings: What to run.
        progress: Told what begins.
    """
    loops, learner, reports = _run(settings, progress)
    told, frozen, ours = loops["told"], loops["frozen"], loops["ours"]
    half = settings.ticks // 2
    rms = {law: float(np.sqrt(np.mean(loops[law].true_rms[half:] ** 2))) for law in LAWS}
    figures = {f"rms_{law}": rms[law] for law in LAWS}
    figures |= {f"rms_ratio_{law}": rms[law] / rms["told"] for law in LAWS[1:]}
    final = ours.plant.response
    errors = learner.model.normalised_errors(final)
    figures["gain_ours"] = excited_gain(
        learner.model.response, final, ours.applied(settings.settle)
    )
    figures["normalised_error_ours"] = float(np.sqrt(np.mean(errors**2)))
    figures["within_two_sigma_ours"] = float(np.mean(np.abs(errors) < 2.0))
    figures |= _naive_figures(settings, frozen if not frozen.lost else told)
    decisions = [report.decision for report in reports]
    figures |= {
        "refits": float(len(reports)),
        "promoted": float(decisions.count(Decision.ACCEPTED)),
        "refit_seconds_max": max((report.duration for report in reports), default=0.0),
    }
    true_rms = {law: loops[law].true_rms for law in LAWS}
    return RefitResult(settings, figures, true_rms, errors, tuple(reports))


def write(result: RefitResult, directory: Path) -> None:
    """Write `refit.json` and `refit.png`.

    Args:
        result: What to write.
        directory: Where; made when it is not there.
    """
    from orbitfb.evaluate.refit_picture import draw

    directory.mkdir(parents=True, exist_ok=True)
    document: dict[str, Any] = {
        **result.figures,
        "within_uncertainty_ours": {
            "normalised_error": result.figures["normalised_error_ours"],
            "within_two_sigma": result.figures["within_two_sigma_ours"],
        },
        "seed": result.settings.seed,
        "settings": result.settings.model_dump(mode="json"),
        "series": {"true_rms_m": {law: list(map(float, y)) for law, y in result.true_rms.items()}},
        "reports": [asdict(report) for report in result.reports],
    }
    (directory / "refit.json").write_text(json.dumps(document, indent=1) + "\n")
    ran = result.settings
    title = f"drift: {ran.drift}, {ran.ticks} ticks, seed {ran.seed}"
    draw(directory / "refit.png", title, result.figures, result.true_rms, result.errors)


def _run(
    settings: RefitEvaluationSettings, progress: Callable[[str], None]
) -> tuple[dict[str, ClosedLoop], Learner, list[RefitReport]]:
    """Run the loops one after another, each on a plant of its own with the same seed."""
    ring = Ring.load()
    plant_settings = PlantSettings(drift=drift_settings(settings), bpm_noise_rms=settings.bpm_noise)

    def plant() -> Plant:
        return plant_with(
            ring, settings.planes, plant_settings, settings.seed, settings.effects, settings.period
        )

    def begin(law: str, policy: Policy) -> ClosedLoop:
        progress(f"{law}: {settings.ticks} ticks")
        return ClosedLoop(plant(), policy, settings.ticks)

    def law(response: Vector) -> SvdPolicy:
        return SvdPolicy(response, settings.policy)

    truth = law(plant().response)
    baseline = law(_first_response(settings, plant()))
    loops = {"frozen": begin("frozen", baseline).run()}
    if settings.drift != "none":
        loops["told"] = begin("told", truth).run(lambda loop: law(loop.plant.response), _LOOK)
    elif settings.start != "true":
        loops["told"] = begin("told", truth).run()
    else:
        loops["told"] = loops["frozen"]

    def naive(loop: ClosedLoop) -> Policy:
        recent = loop.transitions(loop.tick - max(settings.naive_every, 500))
        return law(naive_least_squares(select_rows(recent, _TOLERANCE)))

    loops["naive"] = begin("naive", baseline).run(naive, settings.naive_every)
    build = builder(PolicySettings(svd=settings.policy))
    learner = Learner(baseline.response, settings.learn, build, seed=settings.seed)
    reports: list[RefitReport] = []
    loops["ours"] = begin("ours", baseline).run(Supervision(learner, reports), settings.learn.check)
    return loops, learner, reports


def _first_response(settings: RefitEvaluationSettings, plant: Plant) -> Vector:
    if settings.start == "true":
        return plant.response
    if settings.start == "nominal":
        return plant.nominal_response
    prior = Identifier(plant.response, settings.learn.identify).model
    return prior.sample(np.random.default_rng(settings.seed))


class Supervision:
    """The learner's thread without a thread: the same steps at the same ticks.

    Args:
        learner: Identification and judgement.
        reports: Gets what it did.
    """

    def __init__(self, learner: Learner, reports: list[RefitReport]) -> None:
        self._learner, self._reports = learner, reports
        self._refitted = 0

    def __call__(self, loop: ClosedLoop) -> Policy | None:
        """Look at the loop; return a candidate that was accepted."""
        settings = self._learner.settings
        last = self._learner.last_tick
        new = loop.transitions(0 if last is None else last + 1)
        absorbed = self._learner.absorb(new, loop.policy)
        due = loop.tick - self._refitted >= settings.every
        if not due and not absorbed.chi2_other > settings.chi2_trigger:
            return None
        self._refitted = loop.tick
        report, candidate = self._learner.refit(
            new, loop.policy, "periodic" if due else "degradation"
        )
        self._reports.append(report)
        return candidate if report.decision is Decision.ACCEPTED else None


def drift_settings(settings: RefitEvaluationSettings) -> DriftSettings:
    """Give the preset its length: the whole run."""
    if settings.drift == "none":
        return DriftSettings()
    return DriftSettings.model_validate({"preset": settings.drift, "ticks": settings.ticks})


def _naive_figures(settings: RefitEvaluationSettings, loop: ClosedLoop) -> dict[str, float]:
    """Bias of the naive least squares over a quiet record, measured and expected."""
    rows = select_rows(loop.transitions(settings.settle), _TOLERANCE)
    if len(rows) < rows.change.shape[1]:
        return {}
    estimate = naive_least_squares(rows)
    response = loop.plant.response
    gain = SvdPolicy(response, settings.policy).gain_matrix
    applied = loop.applied(settings.settle)
    moved = float(np.mean(np.sum((applied @ response.T) ** 2, axis=1)))
    loop_gain = float(np.mean(np.diag(response @ gain)))
    noise = loop.plant.settings.bpm_noise_rms**2
    return {
        "gain_naive": excited_gain(estimate, response, applied),
        "gain_naive_expected": 1.0 + noise * loop_gain * len(response) / moved,
        "loop_gain": loop_gain,
        "loop_gain_naive": float(np.mean(np.diag(estimate @ gain))),
        "loop_gain_naive_expected": 1.0 + loop_gain / 2.0,
    }
