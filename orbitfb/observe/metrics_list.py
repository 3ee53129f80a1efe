"""The list of all metrics: the Collector and the page of the docs are made from it."""

from orbitfb.observe.metric import Metric

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
)

BEAM = (
    Metric(
        "orbitfb_orbit_rms_meters",
        "gauge",
        "meters",
        ("plane",),
        "RMS of orbit − reference over the valid BPMs, last orbit.",
    ),
    Metric(
        "orbitfb_orbit_rms_window_meters",
        "gauge",
        "meters",
        ("plane",),
        "The same as quadratic mean over the last 10 s.",
    ),
    Metric(
        "orbitfb_true_orbit_rms_meters",
        "gauge",
        "meters",
        (),
        "RMS of the orbit without BPM noise, last orbit; only a simulated ring knows it.",
    ),
    Metric(
        "orbitfb_true_orbit_rms_window_meters",
        "gauge",
        "meters",
        (),
        "The same as quadratic mean over the last 10 s.",
    ),
    Metric(
        "orbitfb_orbit_error_max_meters",
        "gauge",
        "meters",
        (),
        "Largest |orbit − reference| of a valid BPM, last orbit.",
    ),
    Metric(
        "orbitfb_orbit_timestamp_seconds",
        "gauge",
        "seconds",
        (),
        "Stamp of the last coherent orbit, since the epoch.",
    ),
    Metric("orbitfb_bpms", "gauge", "", (), "BPM readings that the loop listens to."),
    Metric(
        "orbitfb_bpms_masked", "gauge", "", (), "BPM readings that are masked by configuration."
    ),
    Metric(
        "orbitfb_bpms_invalid",
        "gauge",
        "",
        (),
        "BPM readings of the last orbit that are invalid, besides those that are masked.",
    ),
    Metric(
        "orbitfb_corrector_setpoint_max_amperes",
        "gauge",
        "amperes",
        (),
        "|setpoint| of the corrector that is nearest its limit.",
    ),
    Metric(
        "orbitfb_corrector_limit_amperes",
        "gauge",
        "amperes",
        (),
        "Limit of |setpoint| of that corrector.",
    ),
    Metric("orbitfb_stored_current_amperes", "gauge", "amperes", (), "Stored current, last orbit."),
    Metric("orbitfb_rf_frequency_hertz", "gauge", "hertz", (), "RF frequency, last orbit."),
)

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
)

DIAGNOSIS = (
    Metric(
        "orbitfb_gap_nats",
        "gauge",
        "nats",
        (),
        "Gap per tick between the nominal model and the best explanation of the last ticks; 0 when "
        "none is better.",
    ),
    Metric("orbitfb_gap_low_nats", "gauge", "nats", (), "Lower end of its 90 % interval."),
    Metric("orbitfb_gap_high_nats", "gauge", "nats", (), "Upper end of its 90 % interval."),
    Metric(
        "orbitfb_gap_resolved",
        "gauge",
        "",
        (),
        "1 when it is certain that there is a gap, else 0; the alert OrbitGapResolved asks for it.",
    ),
    Metric(
        "orbitfb_gap_suspect_probability",
        "gauge",
        "",
        ("effect",),
        "Probability of the effect that is suspected, among all effects and none.",
    ),
    Metric("orbitfb_gap_ticks", "gauge", "ticks", (), "Ticks that the last look was about."),
    Metric(
        "orbitfb_gap_timestamp_seconds",
        "gauge",
        "seconds",
        (),
        "Last tick that the last look was about, since the epoch.",
    ),
    Metric("orbitfb_gap_duration_seconds", "gauge", "seconds", (), "How long the last look took."),
)

SERVICE = (
    Metric(
        "orbitfb_archive_rows_written_total",
        "counter",
        "",
        (),
        "Transitions that the archive has on disk.",
    ),
    Metric(
        "orbitfb_archive_rows_dropped_total",
        "counter",
        "",
        (),
        "Transitions that the archive could not take.",
    ),
    Metric(
        "orbitfb_archive_rows_waiting",
        "gauge",
        "",
        (),
        "Transitions that wait for the disk; many when it refuses.",
    ),
    Metric(
        "orbitfb_postmortems_written_total",
        "counter",
        "",
        (),
        "Post-mortems, of trips or on request, that were written.",
    ),
    Metric(
        "orbitfb_postmortems_failed_total",
        "counter",
        "",
        (),
        "Post-mortems that could not be written and are lost.",
    ),
    Metric("orbitfb_uptime_seconds", "gauge", "seconds", (), "Time since the service started."),
    Metric("orbitfb_build_info", "info", "", ("version", "python"), "What runs."),
)

METRICS = LOOP + BEAM + LEARNING + DIAGNOSIS + SERVICE
"""All metrics that a scrape exposes, and no other."""
