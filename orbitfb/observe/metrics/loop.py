"""Metrics of the loop."""

from orbitfb.observe.metrics.metric import Metric

LOOP = (
    Metric(
        "orbitfb_loop_state",
        "gauge",
        "",
        ("state",),
        "1 for the state of the loop, 0 for all others; all 0 before the first tick.",
    ),
    Metric(
        "orbitfb_loop_state_entries_total",
        "counter",
        "",
        ("state",),
        "How often the loop entered each state.",
    ),
    Metric(
        "orbitfb_loop_state_duration_seconds",
        "gauge",
        "seconds",
        (),
        "How long the loop has been in its state.",
    ),
    Metric("orbitfb_ticks_total", "counter", "", (), "Ticks of the loop."),
    Metric(
        "orbitfb_missed_ticks_total", "counter", "", (), "Orbits that should have come and did not."
    ),
    Metric(
        "orbitfb_held_back_ticks_total",
        "counter",
        "",
        (),
        "Ticks that wrote nothing, because the readbacks did not yet show the last change.",
    ),
    Metric(
        "orbitfb_answer_asked_ticks_total",
        "counter",
        "",
        (),
        "Ticks at which the loop asked by small excursions whether the orbit answers: a tick or "
        "two a minute at a quiet ring.",
    ),
    Metric(
        "orbitfb_answer_silent_total",
        "counter",
        "",
        (),
        "How often the ring, BPMs or correctors were found not to answer.",
    ),
    Metric(
        "orbitfb_answer_refused_ticks_total",
        "counter",
        "",
        (),
        "Ticks that the learner does not use, because the ring was not seen to answer later.",
    ),
    Metric(
        "orbitfb_limited_ticks_total",
        "counter",
        "",
        (),
        "Ticks whose change of setpoints the limits shortened.",
    ),
    Metric(
        "orbitfb_last_tick_timestamp_seconds",
        "gauge",
        "seconds",
        (),
        "When the last tick ended, since the epoch: the heartbeat.",
    ),
    Metric(
        "orbitfb_tick_latency_seconds",
        "histogram",
        "seconds",
        (),
        "From the complete orbit to the last setpoint sent, ticks that wrote.",
    ),
    Metric(
        "orbitfb_tick_phase_seconds",
        "summary",
        "seconds",
        ("phase",),
        "Time spent in each phase of a tick: read (the wait for the orbit), check, decide, "
        "limit, act.",
    ),
    Metric(
        "orbitfb_tick_period_seconds",
        "gauge",
        "seconds",
        (),
        "Mean time from orbit to orbit over the last 10 s.",
    ),
    Metric(
        "orbitfb_tick_jitter_seconds",
        "gauge",
        "seconds",
        (),
        "Standard deviation of the time from orbit to orbit over the last 10 s.",
    ),
    Metric(
        "orbitfb_tick_period_nominal_seconds",
        "gauge",
        "seconds",
        (),
        "Time between two ticks as configured.",
    ),
    Metric(
        "orbitfb_loop_state_reason_info",
        "info",
        "",
        ("state", "reason"),
        "The state, and the kind of reason why the loop entered it, without figures and names: the "
        "log has them. No reason when there is nothing to say.",
    ),
    Metric(
        "orbitfb_loop_closed_by_info",
        "info",
        "",
        ("user", "host"),
        "Who closed the loop last, and from where; user `start`: the service began so.",
    ),
    Metric(
        "orbitfb_loop_closed_timestamp_seconds",
        "gauge",
        "seconds",
        (),
        "When that was, since the epoch.",
    ),
    Metric(
        "orbitfb_commands_total",
        "counter",
        "",
        ("outcome",),
        "Commands of operators over both doors: given, refused.",
    ),
)
