"""What the operator on shift looks at."""

from dataclasses import replace

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

STATES = {
    0: ("STARTING", "text"),
    1: ("OPEN", BLUE),
    2: ("SHADOW", "purple"),
    3: ("CLOSED", GREEN),
    4: ("HELD", YELLOW),
    5: ("TRIPPED", RED),
    6: ("FAULT", "dark-red"),
}
"""Codes of the recorded state, as deploy/prometheus/orbitfb-rules.yml makes them."""
ALERTS = (
    'ALERTS{job="orbitfb", instance=~"($instance)?", alertname=~"Orbit.+", alertstate="firing"}'
)
"""The one for an absent job has no instance."""
STATE_STEPS = Steps("text", ((1, BLUE), (3, GREEN), (4, YELLOW), (5, RED)))
RMS_LIMIT = 5
"""Orbit RMS as a multiple of the noise above which OrbitRmsHigh fires; a test compares."""
TIMES_NOISE = "suffix: × noise"
ABOVE_NOISE = Steps(GREEN, ((2, YELLOW), (RMS_LIMIT, RED)))

_STATE = (
    Panel(
        "stat",
        "State",
        "OPEN reads, SHADOW decides and does not write, CLOSED corrects, HELD waits and closes by "
        "itself, TRIPPED waits for a reset, FAULT for a restart.",
        "none",
        (Query(metric("orbitfb:loop_state:code"), "state"),),
        4,
        STATE_STEPS,
        4,
        {"texts": STATES},
    ),
    Panel(
        "stat",
        "In this state for",
        "Time since the loop entered its state.",
        "s",
        (Query(metric("loop_state_duration_seconds"), "for"),),
        4,
        INFORMATION,
        4,
        {"decimals": 0},
    ),
    Panel(
        "stat",
        "Why",
        "Why the loop entered its state; the state alone when there is nothing to say.",
        "none",
        (Query(metric("loop_state_reason_info"), "{{state}} {{reason}}"),),
        8,
        INFORMATION,
        4,
        {"names": True},
    ),
    Panel(
        "stat",
        "Closed by",
        "Who gave the last `close` that was carried out; start@localhost: the service began so.",
        "none",
        (Query(metric("loop_closed_by_info"), "{{user}}@{{host}}"),),
        4,
        INFORMATION,
        4,
        {"names": True},
    ),
    Panel(
        "stat",
        "Closed at",
        "When that was.",
        "dateTimeFromNow",
        (Query(f"1000 * {metric('loop_closed_timestamp_seconds')}", "closed"),),
        4,
        INFORMATION,
        4,
    ),
    Panel(
        "state-timeline",
        "State over time",
        "When the loop was in which state; what is missing is time without a service.",
        "none",
        (Query(metric("orbitfb:loop_state:code"), "state"),),
        18,
        STATE_STEPS,
        5,
        {"texts": STATES},
    ),
    Panel(
        "stat",
        "Alerts",
        "Alerts of this service that fire now, and that there is no service at all.",
        "none",
        (Query(f"count({ALERTS}) or vector(0)", "firing"),),
        3,
        Steps(GREEN, ((1, RED),)),
        5,
    ),
    Panel(
        "stat",
        "Closed, last day",
        "Part of the last day in CLOSED, while there was a service.",
        "percentunit",
        (Query(metric("orbitfb:loop_closed:avg1d"), "closed"),),
        3,
        Steps(RED, ((0.9, YELLOW), (0.99, GREEN))),
        5,
        {"decimals": 1},
    ),
)

_ORBIT = (
    Panel(
        "timeseries",
        "Orbit RMS against the noise floor",
        "RMS of orbit − reference over the valid BPMs, quadratic mean of 10 s. Below it the noise "
        "of one BPM reading: a closed loop rests a little above it. True: without BPM noise, which "
        "only a simulated ring knows.",
        "lengthm",
        (
            Query(metric("orbit_rms_window_meters"), "orbit {{plane}}"),
            Query(metric("bpm_noise_meters"), "noise floor ({{source}})", "floor"),
            Query(
                f"{RMS_LIMIT} * max without (source) ({metric('bpm_noise_meters')})",
                "alert above",
                "limit",
            ),
            Query(metric("true_orbit_rms_window_meters"), "true"),
        ),
        12,
        INFORMATION,
        9,
        {"log": True},
    ),
    Panel(
        "timeseries",
        "Orbit RMS over the noise floor",
        f"1 is the floor; above {RMS_LIMIT} for a minute the alert OrbitRmsHigh fires.",
        TIMES_NOISE,
        (Query(metric("orbitfb:orbit_rms:noise_ratio"), "{{plane}}"),),
        8,
        replace(ABOVE_NOISE, shown=True),
        9,
        {"log": True},
    ),
    Panel(
        "stat",
        "Orbit RMS",
        "The same, now. Red: above the limit of the alert OrbitRmsHigh.",
        TIMES_NOISE,
        (
            Query(metric("orbitfb:orbit_rms:noise_ratio"), "{{plane}}"),
            Query(metric("orbit_rms_window_meters"), "{{plane}} ", unit="lengthm"),
        ),
        4,
        ABOVE_NOISE,
        9,
        {"decimals": 2},
    ),
)

_DEVICES = (
    Panel(
        "bargauge",
        "Worst BPMs",
        "RMS of orbit − reference over 10 s of the five worst, as a multiple of the noise of one "
        "reading. One that stands out is a bad BPM or a local kick; all alike is noise.",
        TIMES_NOISE,
        (
            Query(
                f"sort_desc({metric('orbitfb:bpm_error:noise_ratio')})",
                "{{bpm}} {{plane}}",
            ),
        ),
        8,
        ABOVE_NOISE,
        8,
        {"min": 0, "decimals": 1},
    ),
    Panel(
        "bargauge",
        "Correctors nearest their limits",
        "|setpoint| as part of its limit, the five nearest. At 90 % the alert "
        "OrbitCorrectorNearLimit fires.",
        "percentunit",
        (Query(f"sort_desc({metric('corrector_usage_ratio')})", "{{corrector}} {{plane}}"),),
        8,
        Steps(GREEN, ((0.7, YELLOW), (0.9, RED))),
        8,
        {"min": 0, "max": 1, "decimals": 1},
    ),
    Panel(
        "timeseries",
        "Nearest corrector",
        "|setpoint| over its limit of the corrector that is nearest; it must not creep.",
        "percentunit",
        (Query(metric("orbitfb:corrector_usage:max"), "nearest"),),
        8,
        Steps(GREEN, ((0.7, YELLOW), (0.9, RED)), shown=True),
        8,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "BPM readings left out",
        "Invalid: should count and do not; masked: by configuration. Above the limit the loop is "
        "HELD.",
        "none",
        (
            Query(metric("bpms_invalid"), "invalid"),
            Query(metric("bpms_masked"), "masked"),
            Query(metric("bpms_invalid_limit"), "most that may be invalid", "floor"),
        ),
        8,
        Steps(GREEN, ((1, YELLOW), (10, RED))),
        7,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Stored current",
        "A loss of part of it trips the loop.",
        "amp",
        (Query(metric("stored_current_amperes"), "current"),),
        8,
        Steps(RED, ((0.01, GREEN),)),
        7,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Commands, last 15 min",
        "Commands of operators over both doors; the log names who gave which.",
        "none",
        (Query(f"increase({metric('commands_total')}[15m])", "{{outcome}}", "bars"),),
        8,
        Steps(BLUE, ((1000, YELLOW),)),
        7,
        {"min": 0, "decimals": 0},
    ),
)

SHIFT = Dashboard(
    "shift",
    "Orbit feedback: Shift",
    "Is the loop closed, is the orbit good, and what stands out.",
    (("State", _STATE), ("Orbit", _ORBIT), ("BPMs and correctors", _DEVICES)),
)
