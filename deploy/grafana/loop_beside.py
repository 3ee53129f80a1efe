"""Rows of the dashboard Loop beside the ticks: Channel Access and the archive."""

from deploy.grafana.panels import BLUE, GREEN, INFORMATION, RED, YELLOW, Panel, Query, Steps, metric

ACCESS = (
    Panel(
        "stat",
        "Channels away",
        "Channels to the machine that are not connected now; the log names them.",
        "none",
        (Query(metric("orbitfb:channels_away:sum"), "away"),),
        4,
        Steps(GREEN, ((1, RED),)),
        8,
    ),
    Panel(
        "timeseries",
        "Channels connected",
        "By kind; a setpoint that is away lets nothing be written.",
        "none",
        (
            Query(metric("channel_access_channels_connected"), "{{kind}}"),
            Query(metric("channel_access_channels"), "{{kind}}, all", "floor"),
        ),
        10,
        Steps(RED, ((1, GREEN),)),
        8,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Channels lost, last 15 min",
        "How often a channel went away: an IOC that restarts loses all of its own at once.",
        "none",
        (Query(f"increase({metric('channel_access_losses_total')}[15m])", "{{kind}}", "bars"),),
        10,
        Steps(GREEN, ((1, YELLOW), (100, RED))),
        8,
        {"min": 0, "decimals": 0},
    ),
)

ARCHIVE = (
    Panel(
        "stat",
        "Disk",
        "Whether the disk takes the archive.",
        "none",
        (Query(metric("archive_failing"), "disk"),),
        4,
        Steps(GREEN, ((1, RED),)),
        7,
        {"texts": {0: ("writes", GREEN), 1: ("refuses", RED)}},
    ),
    Panel(
        "timeseries",
        "Rows to disk",
        "Per second; it follows the rate of the ticks.",
        "hertz",
        (
            Query(metric("orbitfb:archive_rows:rate2m"), "rows"),
            Query(metric("orbitfb:ticks:rate2m"), "ticks", "floor"),
        ),
        7,
        INFORMATION,
        7,
        {"min": 0},
    ),
    Panel(
        "timeseries",
        "Rows waiting, rows dropped in 5 min",
        "Rows wait for the disk in memory; when `history.archive.queue` is full they are dropped.",
        "none",
        (
            Query(metric("archive_rows_waiting"), "waiting"),
            Query(f"increase({metric('archive_rows_dropped_total')}[5m])", "dropped", "bars"),
        ),
        7,
        Steps(GREEN, ((100, YELLOW), (1000, RED))),
        7,
        {"min": 0, "decimals": 0},
    ),
    Panel(
        "stat",
        "Post-mortems since the start",
        "Written: of trips or on request. Failed: lost.",
        "none",
        (
            Query(metric("postmortems_written_total"), "written"),
            Query(metric("postmortems_failed_total"), "failed"),
        ),
        6,
        Steps(GREEN, ((1, YELLOW),)),
        7,
    ),
)

ENERGY = (
    Panel(
        "stat",
        "RF frequency",
        "Whether it follows the energy while the loop is closed; left alone: `RfReason-I` and the "
        "log say why.",
        "none",
        (Query(metric("rf_follows"), "RF"),),
        4,
        INFORMATION,
        7,
        {"texts": {0: ("left alone", BLUE), 1: ("follows", GREEN)}},
    ),
    Panel(
        "timeseries",
        "Energy of the correctors",
        "Relative energy that the correctors make; a step of the frequency takes it over once it "
        "is beyond `rf.dead_band`.",
        "none",
        (Query(metric("corrector_energy_ratio"), "energy"),),
        8,
        INFORMATION,
        7,
    ),
    Panel(
        "timeseries",
        "Steps in 5 min",
        "Steps of the frequency by the loop.",
        "none",
        (Query(f"increase({metric('rf_steps_total')}[5m])", "steps"),),
        6,
        INFORMATION,
        7,
        {"min": 0, "decimals": 0},
    ),
    Panel(
        "timeseries",
        "RF column over the table's",
        "Size of the column in use, and of what refits found with its 95 % interval.",
        "none",
        (
            Query(metric("rf_column_ratio"), "in use"),
            *(
                Query(metric("last_refit_figure", f'figure="{figure}"'), legend)
                for figure, legend in (
                    ("rf_ratio", "found"),
                    ("rf_ratio_low", "low"),
                    ("rf_ratio_high", "high"),
                )
            ),
        ),
        6,
        INFORMATION,
        7,
    ),
)

ANSWERS = (
    Panel(
        "timeseries",
        "Ticks that ask, last 5 min",
        "The loop moves the correctors a little and looks whether the orbit answers: rarely at a "
        "quiet ring, at every tick while something is in doubt.",
        "none",
        (Query(f"increase({metric('answer_asked_ticks_total')}[5m])", "asked"),),
        8,
        INFORMATION,
        7,
        {"min": 0, "decimals": 0},
    ),
    Panel(
        "timeseries",
        "Found without an answer, last 15 min",
        "The ring, BPMs or correctors: the log names them.",
        "none",
        (Query(f"increase({metric('answer_silent_total')}[15m])", "found", "bars"),),
        8,
        Steps(GREEN, ((1, RED),)),
        7,
        {"min": 0, "decimals": 0},
    ),
    Panel(
        "timeseries",
        "Ticks that teach nobody, last 5 min",
        "Rows of the archive that no refit uses: the ring was not seen to answer after them.",
        "none",
        (Query(f"increase({metric('answer_refused_ticks_total')}[5m])", "left out"),),
        8,
        INFORMATION,
        7,
        {"min": 0, "decimals": 0},
    ),
)
