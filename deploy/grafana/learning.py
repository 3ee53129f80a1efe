"""What the learner found, and what became of it."""

from deploy.grafana.dashboard import Dashboard
from deploy.grafana.panels import (
    BLUE,
    GREEN,
    INFORMATION,
    RED,
    YELLOW,
    Panel,
    Query,
    Steps,
    metric,
)


def _figure(*names: str) -> str:
    return metric("last_refit_figure", f'figure=~"{"|".join(names)}"')


_ROLLED_BACK = metric("refits_total", 'decision="rolled_back"')

_VERDICTS = (
    Panel(
        "stat",
        "Policy in force",
        "The law that decides; `orbitfb policies list` tells where it comes from.",
        "none",
        (Query(metric("policy_info"), "{{policy}}"),),
        6,
        INFORMATION,
        4,
        {"names": True},
    ),
    Panel(
        "stat",
        "Last verdict",
        "What became of the last candidate, where it was decided, and why; figures are in the log.",
        "none",
        (Query(metric("last_refit_info"), "{{decision}} ({{stage}}): {{reason}}"),),
        12,
        INFORMATION,
        4,
        {"names": True},
    ),
    Panel(
        "stat",
        "Last refit",
        "How long ago the last refit ended; it is made every `learn.every` ticks.",
        "s",
        (Query(f"time() - {metric('last_refit_timestamp_seconds')}", "ago"),),
        3,
        Steps(GREEN, ((300, YELLOW), (3600, RED))),
        4,
        {"decimals": 0},
    ),
    Panel(
        "stat",
        "Rolled back, last day",
        "Policies that the judge accepted and that made the orbit worse.",
        "none",
        (Query(f"increase({_ROLLED_BACK}[1d])", "rolled back"),),
        3,
        Steps(GREEN, ((1, RED),)),
        4,
        {"decimals": 0},
    ),
    Panel(
        "timeseries",
        "Judge's verdicts, last 10 min",
        "Candidates by what became of them. Most are refused on a ring that does not change: they "
        "would gain less than the margin.",
        "none",
        (Query(f"increase({metric('refits_total')}[10m])", "{{decision}}", "bars"),),
        12,
        Steps(BLUE, ((1000, YELLOW),)),
        8,
        {"min": 0, "stack": True, "decimals": 0},
    ),
    Panel(
        "table",
        "Reasons since the start",
        "Candidates by decision, stage and reason.",
        "none",
        (Query(f"sort_desc({metric('refit_reasons_total')})"),),
        12,
        INFORMATION,
    ),
    Panel(
        "timeseries",
        "Predicted true orbit",
        "What the judge expects of candidate and incumbent on responses that the data allow.",
        "lengthm",
        (Query(_figure("predicted_rms_candidate", "predicted_rms_incumbent"), "{{figure}}"),),
        8,
        Steps(GREEN, ((10e-6, RED),)),
    ),
    Panel(
        "timeseries",
        "Evidence for R̂",
        "Log-likelihood of rows that were not used yet under R̂ over that under the incumbent's "
        "response; far below 0 the candidate is refused.",
        "suffix: nats",
        (Query(_figure("evidence"), "evidence"),),
        8,
        Steps(RED, ((-10, GREEN),), shown=True),
    ),
    Panel(
        "timeseries",
        "Policy swaps",
        "How often the policy changed since the start.",
        "none",
        (Query(metric("policy_swaps_total"), "swaps"),),
        8,
        INFORMATION,
        8,
        {"min": 0, "decimals": 0},
    ),
)

_MODEL = (
    Panel(
        "timeseries",
        "R̂ change",
        "‖R̂ − R‖ / ‖R‖ from the response of the policy in force, and how uncertain R̂ is. A "
        "change below the uncertainty is none.",
        "percentunit",
        (
            Query(metric("response_change_ratio"), "change"),
            Query(metric("response_uncertainty_ratio"), "uncertainty", "floor"),
        ),
        8,
        Steps(GREEN, ((0.1, YELLOW), (0.3, RED))),
        8,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Surprise",
        "Mean squared normalised innovation of R̂ and of the incumbent's response: 1 when the model "
        "explains the orbits; above `learn.chi2_trigger` a refit comes at once.",
        "none",
        (Query(_figure("chi2", "chi2_incumbent"), "{{figure}}"),),
        8,
        Steps(GREEN, ((1.3, RED),), shown=True),
    ),
    Panel(
        "timeseries",
        "Model alarms, last 10 min",
        "How often the running model no longer explained the orbits, by cause.",
        "none",
        (Query(f"increase({metric('alarms_total')}[10m])", "{{cause}}", "bars"),),
        8,
        Steps(GREEN, ((1, YELLOW),)),
        8,
        {"min": 0, "decimals": 0},
    ),
    Panel(
        "timeseries",
        "Noise and ground",
        "BPM noise and orbit motion per tick as the last refit found them.",
        "lengthm",
        (Query(_figure("reading_noise", "ground"), "{{figure}}"),),
        8,
        Steps(GREEN, ((1e-6, YELLOW), (10e-6, RED))),
        8,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Refit duration",
        "How long a refit took, in a process of its own.",
        "s",
        (Query(metric("last_refit_duration_seconds"), "duration"),),
        8,
        Steps(GREEN, ((10, YELLOW), (60, RED))),
        8,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Rows of the last refit",
        "Transitions that went in since this policy is in force.",
        "none",
        (Query(metric("last_refit_rows"), "rows"),),
        8,
        Steps(YELLOW, ((40, GREEN),)),
        8,
        {"min": 0},
    ),
)

_EXCITATION = (
    Panel(
        "timeseries",
        "Excitation",
        "RMS change of a setpoint per tick, quadratic mean of 10 s: all that was written, and the "
        "part of it that is dither. Without any the learner learns nothing.",
        "amp",
        (
            Query(metric("setpoint_change_rms_amperes"), "all"),
            Query(metric("dither_change_rms_amperes"), "dither"),
        ),
        12,
        Steps(GREEN, ((1, YELLOW), (2, RED))),
        8,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Orbit cost of the dither",
        "Orbit motion that the dither may cause, beside the noise floor; 0: no dither.",
        "lengthm",
        (
            Query(metric("dither_orbit_cost_meters"), "cost"),
            Query(metric("bpm_noise_meters"), "noise floor", "floor"),
        ),
        12,
        Steps(GREEN, ((1e-6, YELLOW), (10e-6, RED))),
        8,
        {"min": 0},
    ),
)

LEARNING = Dashboard(
    "learning",
    "Orbit feedback: Learning",
    "What the learner found, what the judge said, and what there was to learn from.",
    (("Verdicts", _VERDICTS), ("Model", _MODEL), ("Excitation", _EXCITATION)),
    "now-3h",
)
