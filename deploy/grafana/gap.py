"""The gap between model and machine."""

from deploy.grafana.dashboard import Dashboard
from deploy.grafana.panels import BLUE, GREEN, INFORMATION, RED, YELLOW, Panel, Query, Steps, metric

NATS = "suffix: nats"
_SHRUNK = Steps(RED, ((0.5, YELLOW), (0.9, GREEN)))

_NOW = (
    Panel(
        "stat",
        "Gap",
        "Resolved: it is certain that the machine answers otherwise than the model says.",
        "none",
        (Query(metric("gap_resolved"), "gap"),),
        4,
        Steps(GREEN, ((1, RED),)),
        4,
        {"texts": {0: ("none that is certain", GREEN), 1: ("resolved", RED)}},
    ),
    Panel(
        "stat",
        "Suspected effect",
        "The effect that explains the last ticks best, with its devices. It is no diagnosis yet.",
        "none",
        (Query(metric("gap_suspect_info"), "{{effect}} at {{places}}"),),
        8,
        INFORMATION,
        4,
        {"names": True},
    ),
    Panel(
        "stat",
        "Stage",
        "Where in the chain the effect acts: actuator, optics, disturbance, sensor, noise, timing.",
        "none",
        (Query(metric("gap_suspect_info"), "{{stage}}"),),
        4,
        INFORMATION,
        4,
        {"names": True},
    ),
    Panel(
        "stat",
        "Its probability",
        "Among all effects and none.",
        "percentunit",
        (Query(metric("gap_suspect_probability"), "{{effect}}"),),
        4,
        Steps(BLUE, ((0.9, YELLOW), (0.99, RED))),
        4,
        {"decimals": 1},
    ),
    Panel(
        "stat",
        "Last look",
        "Age of the last tick that was looked at; the service looks every `diagnose.live.period`.",
        "s",
        (Query(f"time() - {metric('gap_timestamp_seconds')}", "ago"),),
        4,
        Steps(GREEN, ((300, YELLOW), (600, RED))),
        4,
        {"decimals": 0},
    ),
)

_SIZE = (
    Panel(
        "timeseries",
        "Size of the gap with its interval",
        "Gap per tick between the nominal model and the best explanation of the last ticks, with "
        "its 90 % interval; 0 when nothing explains them better.",
        NATS,
        (
            Query(metric("gap_nats"), "gap"),
            Query(metric("gap_low_nats"), "low", "band"),
            Query(metric("gap_high_nats"), "high", "band"),
        ),
        16,
        Steps(GREEN, ((0.1, YELLOW), (1, RED))),
        9,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Suspected effect over time",
        "Probability of the effect that was suspected at each look, with its stage.",
        "percentunit",
        (Query(metric("gap_suspect_probability"), "{{effect}} ({{stage}})"),),
        8,
        Steps(BLUE, ((0.99, RED),), shown=True),
        9,
        {"min": 0, "max": 1},
    ),
)

_SHRINK = (
    Panel(
        "timeseries",
        "Shrink since the largest of the last day",
        "How much of the largest gap of the last day is gone: after the repair, or with the effect "
        "in the model. Absent while there was no gap.",
        "percentunit",
        (Query(metric("orbitfb:gap_shrink:ratio1d"), "shrink"),),
        12,
        _SHRUNK,
        8,
        {"max": 1},
    ),
    Panel(
        "stat",
        "Shrink by the last diagnosis",
        "Share of the gap that is gone with the causes in the model, on data used for nothing "
        "else, with its 90 % interval: of `orbitfb diagnose DATA/archive`; absent before the "
        "first.",
        "percentunit",
        (
            Query(metric("diagnosis_shrink_ratio"), "shrink"),
            Query(metric("diagnosis_shrink_low_ratio"), "low"),
            Query(metric("diagnosis_shrink_high_ratio"), "high"),
        ),
        6,
        _SHRUNK,
        8,
        {"decimals": 0},
    ),
    Panel(
        "stat",
        "Gap of the last diagnosis",
        "Gap per tick that it found.",
        NATS,
        (Query(metric("diagnosis_gap_nats"), "gap"),),
        3,
        Steps(GREEN, ((0.1, YELLOW), (1, RED))),
        8,
        {"decimals": 2},
    ),
    Panel(
        "stat",
        "Last diagnosis",
        "How long ago it was written.",
        "s",
        (Query(f"time() - {metric('diagnosis_timestamp_seconds')}", "ago"),),
        3,
        Steps(GREEN, ((7 * 86400, YELLOW), (30 * 86400, RED))),
        8,
        {"decimals": 0},
    ),
)

_WATCH = (
    Panel(
        "timeseries",
        "Ticks looked at",
        "Closed, usable ticks of the last look; more resolve a smaller gap.",
        "none",
        (Query(metric("gap_ticks"), "ticks"),),
        12,
        Steps(YELLOW, ((250, GREEN),)),
        7,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Duration of a look",
        "In a process of low priority; long ones mean a busy computer.",
        "s",
        (Query(metric("gap_duration_seconds"), "duration"),),
        12,
        Steps(GREEN, ((30, YELLOW), (120, RED))),
        7,
        {"min": 0},
    ),
)

GAP = Dashboard(
    "gap",
    "Orbit feedback: Gap",
    "Does the machine answer as the model says, and if not, what is suspected.",
    (("Now", _NOW), ("Size", _SIZE), ("Shrink", _SHRINK), ("The watch", _WATCH)),
    "now-12h",
)
