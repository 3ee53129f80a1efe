"""Metrics of policies and the learner."""

from orbitfb.observe.metrics.metric import Metric

LEARNING = (
    Metric("orbitfb_policy_info", "info", "", ("policy",), "The policy that decides."),
    Metric("orbitfb_policy_swaps_total", "counter", "", (), "How often the policy changed."),
    Metric(
        "orbitfb_refits_total",
        "counter",
        "",
        ("decision",),
        "Candidates by what became of them: promoted, refused, rolled_back.",
    ),
    Metric(
        "orbitfb_alarms_total",
        "counter",
        "",
        ("cause",),
        "How often the running model no longer explained the orbits, by cause.",
    ),
    Metric(
        "orbitfb_last_alarm_delay_ticks",
        "gauge",
        "ticks",
        (),
        "Ticks from the change to the last such alarm, as far as its statistic can tell.",
    ),
    Metric(
        "orbitfb_last_refit_timestamp_seconds",
        "gauge",
        "seconds",
        (),
        "When the last refit ended, since the epoch.",
    ),
    Metric(
        "orbitfb_last_refit_duration_seconds",
        "gauge",
        "seconds",
        (),
        "How long the last refit took.",
    ),
    Metric(
        "orbitfb_last_refit_rows", "gauge", "", (), "Transitions that went into the last refit."
    ),
    Metric(
        "orbitfb_last_refit_figure",
        "gauge",
        "",
        ("figure",),
        "Judged figures of the last refit by name, in SI units (change of the model, orbit RMS "
        "of candidate and incumbent, …).",
    ),
    Metric(
        "orbitfb_refit_reasons_total",
        "counter",
        "",
        ("decision", "stage", "reason"),
        "Candidates by decision, by stage (judge, shadow, watch) and by reason; figures are taken "
        "out of the reason, and after 40 of them the rest is `other`.",
    ),
    Metric(
        "orbitfb_last_refit_info",
        "info",
        "",
        ("decision", "stage", "trigger", "reason"),
        "Result of the last refit; figures are taken out of the reason, the log has them.",
    ),
    Metric(
        "orbitfb_response_change_ratio",
        "gauge",
        "ratio",
        (),
        "Relative change from the response of the policy in force to R̂, ‖R̂ − R‖ / ‖R‖, last refit.",
    ),
    Metric(
        "orbitfb_response_uncertainty_ratio",
        "gauge",
        "ratio",
        (),
        "Relative uncertainty of R̂ by its posterior, last refit.",
    ),
    Metric(
        "orbitfb_setpoint_change_rms_amperes",
        "gauge",
        "amperes",
        (),
        "Change of a setpoint per tick that was written, RMS over the correctors and the last 10 "
        "s: what the learner learns from.",
    ),
    Metric(
        "orbitfb_dither_change_rms_amperes",
        "gauge",
        "amperes",
        (),
        "The part of it that is dither or planned excitation.",
    ),
    Metric(
        "orbitfb_dither_orbit_cost_meters",
        "gauge",
        "meters",
        (),
        "Orbit motion that the dither may cause, rms over the BPMs; 0: no dither.",
    ),
)
