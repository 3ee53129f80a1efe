"""Metrics of the diagnosis and of the service."""

from orbitfb.observe.metrics.metric import Metric

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
        ("effect", "stage"),
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
    Metric(
        "orbitfb_gap_suspect_info",
        "info",
        "",
        ("effect", "stage", "places"),
        "The effect that is suspected, its stage (actuator, optics, disturbance, sensor, noise, "
        "timing) and its devices.",
    ),
    Metric(
        "orbitfb_diagnosis_timestamp_seconds",
        "gauge",
        "seconds",
        (),
        "When `archive.diagnosis/diagnosis.json` of the data directory was written, since the "
        "epoch; absent, as the figures below, while there is none.",
    ),
    Metric(
        "orbitfb_diagnosis_gap_nats",
        "gauge",
        "nats",
        (),
        "Gap per tick that this diagnosis found.",
    ),
    Metric(
        "orbitfb_diagnosis_shrink_ratio",
        "gauge",
        "ratio",
        (),
        "Share of the gap that is gone with the causes in the model, on data used for nothing "
        "else.",
    ),
    Metric(
        "orbitfb_diagnosis_shrink_low_ratio",
        "gauge",
        "ratio",
        (),
        "Lower end of its 90 % interval.",
    ),
    Metric(
        "orbitfb_diagnosis_shrink_high_ratio",
        "gauge",
        "ratio",
        (),
        "Upper end of its 90 % interval.",
    ),
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
    Metric(
        "orbitfb_archive_failing",
        "gauge",
        "",
        (),
        "1 while nothing can be written to disk, else 0.",
    ),
    Metric(
        "orbitfb_clock_steps_total",
        "counter",
        "",
        (),
        "How often a clock was set, that of this computer or that of the machine's stamps.",
    ),
    Metric(
        "orbitfb_settings_unsaved",
        "gauge",
        "",
        (),
        "1 while settings of operators are in force that could not be saved yet, else 0.",
    ),
    Metric(
        "orbitfb_channel_access_channels",
        "gauge",
        "",
        ("kind",),
        "Channels to the machine by kind: bpm, setpoint, readback, auxiliary.",
    ),
    Metric(
        "orbitfb_channel_access_channels_connected",
        "gauge",
        "",
        ("kind",),
        "Those that are connected.",
    ),
    Metric(
        "orbitfb_channel_access_losses_total",
        "counter",
        "",
        ("kind",),
        "How often one of them went away.",
    ),
)
