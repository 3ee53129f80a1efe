"""Metrics of beam, BPMs and correctors."""

from orbitfb.observe.metrics.metric import Metric

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
    Metric(
        "orbitfb_rf_follows",
        "gauge",
        "",
        (),
        "1: the RF frequency follows the energy while the loop is closed; 0: it is left alone.",
    ),
    Metric("orbitfb_rf_steps_total", "counter", "", (), "Steps of the RF frequency by the loop."),
    Metric(
        "orbitfb_rf_column_ratio",
        "gauge",
        "ratio",
        (),
        "RF column in use over that of the places table; what the last refit found are its figures "
        "`rf_ratio`, `rf_ratio_low` and `rf_ratio_high`.",
    ),
    Metric(
        "orbitfb_corrector_energy_ratio",
        "gauge",
        "ratio",
        (),
        "Relative energy that the correctors make since the loop settled, which a step of the "
        "RF frequency takes over.",
    ),
    Metric(
        "orbitfb_bpm_noise_meters",
        "gauge",
        "meters",
        ("source",),
        "Noise of one BPM reading, rms: the noise floor of the orbit RMS. Source `refit`: what "
        "the last refit found; `configuration`: what to believe before the first one.",
    ),
    Metric(
        "orbitfb_bpm_error_rms_meters",
        "gauge",
        "meters",
        ("bpm", "plane"),
        "RMS of orbit − reference over the last 10 s of the five worst BPMs; the "
        "others are left out.",
    ),
    Metric(
        "orbitfb_bpms_invalid_limit",
        "gauge",
        "",
        (),
        "Invalid BPM readings above which the loop is HELD.",
    ),
    Metric(
        "orbitfb_corrector_usage_ratio",
        "gauge",
        "ratio",
        ("corrector", "plane"),
        "|setpoint| as part of its limit of the five correctors nearest theirs; the others are "
        "left out.",
    ),
)
