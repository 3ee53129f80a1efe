"""For each alert series with which it fires, and series that come near and do not.

Values are in promtool's notation, one every ten seconds: `0x30` is 0, then 30 more of it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

Series = Mapping[str, str]
OWN = 'job="orbitfb", instance="ring"'


@dataclass(frozen=True, slots=True)
class Case:
    """One alert.

    Args:
        fires: Series with which it fires, by selector without job and instance.
        quiet: Sets of series with which it does not.
        at: When to look.
        labels: What the alert that fires tells besides, part of its text.
    """

    fires: Series
    quiet: tuple[Series, ...]
    at: str = "5m"
    says: str = ""


def state(word: str, values: str = "1x60") -> Series:
    """Return the states of a loop that is in one of them."""
    words = ("OPEN", "SHADOW", "CLOSED", "HELD", "TRIPPED", "FAULT")
    none = "0x60"
    return {
        f'orbitfb_loop_state{{state="{one}"}}': values if one == word else none for one in words
    }


def refits(promoted: str, refused: str, rolled_back: str, alarms: str) -> Series:
    """Return the counters of the learner."""
    return {
        'orbitfb_refits_total{decision="promoted"}': promoted,
        'orbitfb_refits_total{decision="refused"}': refused,
        'orbitfb_refits_total{decision="rolled_back"}': rolled_back,
        'orbitfb_alarms_total{cause="drift"}': alarms,
        'orbitfb_last_refit_info{decision="refused", reason="not better"}': "1x60",
    }


def archive(written: str, dropped: str, failing: str, ticks: str = "0+100x60") -> Series:
    """Return the figures of an archive."""
    return {
        "orbitfb_archive_rows_written_total": written,
        "orbitfb_archive_rows_dropped_total": dropped,
        "orbitfb_archive_failing": failing,
        "orbitfb_ticks_total": ticks,
    }


def orbit(rms: str, noise: str = "0.2x60") -> Series:
    """Return an orbit and its noise, here in µm: only the ratio counts."""
    return {
        'orbitfb_orbit_rms_window_meters{plane="x"}': rms,
        'orbitfb_bpm_noise_meters{source="refit"}': noise,
    }


def pace(missed: str, period: str, latency: float) -> Series:
    """Return the pace of a loop at 10 Hz, its ticks all of one latency."""
    buckets = {
        f'orbitfb_tick_latency_seconds_bucket{{le="{bound}"}}': "0+100x60"
        if bound == "+Inf" or latency <= float(bound)
        else "0x60"
        for bound in ("0.001", "0.01", "0.05", "0.1", "+Inf")
    }
    return {
        **buckets,
        "orbitfb_tick_latency_seconds_count": "0+100x60",
        "orbitfb_ticks_total": "0+100x60",
        "orbitfb_missed_ticks_total": missed,
        "orbitfb_tick_period_seconds": period,
        "orbitfb_tick_period_nominal_seconds": "0.1x60",
    }


def gap(resolved: str, stamp: str) -> Series:
    """Return a look at the gap."""
    return {
        "orbitfb_gap_resolved": resolved,
        "orbitfb_gap_timestamp_seconds": stamp,
        'orbitfb_gap_suspect_probability{effect="bpm-gain", stage="sensor"}': "0.98x120",
        'orbitfb_gap_suspect_info{effect="bpm-gain", stage="sensor", places="PH1A_C18"}': "1x120",
    }


def alive(last: str, ticks: str, period: str = "0.1x120") -> Series:
    """Return the signs of life of a service that Prometheus reaches."""
    return {
        "up": "1x120",
        "orbitfb_last_tick_timestamp_seconds": last,
        "orbitfb_ticks_total": ticks,
        "orbitfb_tick_period_nominal_seconds": period,
        "orbitfb_uptime_seconds": "100+10x120",
    }


CASES = {
    "OrbitNotClosed": Case(
        {**state("HELD"), 'orbitfb_loop_state_reason_info{state="HELD", reason="away"}': "1x60"},
        (state("CLOSED"), state("CLOSED", "1x22 0x40")),
        says="It is HELD (away)",
    ),
    "OrbitTripped": Case(
        {
            **state("TRIPPED"),
            'orbitfb_loop_state_reason_info{state="TRIPPED", reason="no beam"}': "1x60",
        },
        (state("HELD"), state("OPEN")),
        says="no beam.",
    ),
    "OrbitRmsHigh": Case(
        state("CLOSED") | orbit("1.2x60"),
        (
            state("CLOSED") | orbit("0.9x60"),
            state("OPEN") | orbit("100x60"),
            state("CLOSED") | orbit("0.2x26 100x40"),
        ),
        says="6.0 times the BPM noise in x",
    ),
    "OrbitTickLate": Case(
        pace("0+2x60", "0.1x60", 0.005),
        (pace("0x60", "0.1x60", 0.005), pace("0+0.5x60", "0.105x60", 0.04)),
        at="8m",
    ),
    "OrbitBpmsMasked": Case(
        {"orbitfb_bpms_invalid": "3x60", "orbitfb_bpms_invalid_limit": "9x60"},
        (
            {"orbitfb_bpms_invalid": "0x60", "orbitfb_bpms_masked": "4x60"},
            {"orbitfb_bpms_invalid": "0x20 2x40"},
        ),
        says="with more than 9 it is HELD",
    ),
    "OrbitCorrectorNearLimit": Case(
        {'orbitfb_corrector_usage_ratio{corrector="CH1A_C10", plane="x"}': "0.95x60"},
        ({'orbitfb_corrector_usage_ratio{corrector="CH1A_C10", plane="x"}': "0.89x60"},),
        says="CH1A_C10 (x) is at 95% of its limit",
    ),
    "OrbitRefitRefused": Case(
        refits("0x60", "0 0 0 1x60", "0x60", "0 0 1x60"),
        (
            refits("0x60", "0+1x60", "0x60", "0x60"),
            refits("0 0 0 0 1x60", "0 0 0 1x60", "0x60", "0 0 1x60"),
        ),
        says="pass: not better.",
    ),
    "OrbitRolledBack": Case(
        refits("0x60", "0x60", "0 0 1x60", "0x60"), (refits("0+1x60", "0+1x60", "3x60", "0x60"),)
    ),
    "OrbitGapResolved": Case(
        gap("1x60", "0+10x60"),
        (gap("0x60", "0+10x60"), gap("1x120", "0x120")),
        at="15m",
        says="Suspected is bpm-gain (probability 0.98, stage sensor) at PH1A_C18.",
    ),
    "OrbitArchiveNotWriting": Case(
        archive("0x60", "0x60", "1x60"), (archive("0+100x60", "0x60", "0x60"),)
    ),
    "OrbitSettingsNotSaved": Case(
        {"orbitfb_settings_unsaved": "1x60"}, ({"orbitfb_settings_unsaved": "0x60"},)
    ),
    "OrbitHeartbeatGone": Case(
        {"up": "0x60"},
        (
            alive("0+10x60", "0+100x60"),
            alive("-100+10x60", "0+100x60"),  # its clock is behind
            alive("0+10x10 100+0x2 130+10x60", "0+100x10 1000x2 1100+100x60"),  # 30 s without
            alive("0x5 60x5 120x5 180x5 240x5", "0x5 1x5 2x5 3x5 4x5", "60x60"),  # one a minute
        ),
    ),
}
"""By the name of the alert."""

ALSO_FIRES: tuple[tuple[str, Series], ...] = (
    ("OrbitTripped", state("FAULT")),
    ("OrbitNotClosed", state("none of them")),
    ("OrbitTickLate", pace("0x60", "0.12x60", 0.005)),
    ("OrbitTickLate", pace("0x60", "0.1x60", 0.09)),
    ("OrbitArchiveNotWriting", archive("5x60", "0x60", "0x60")),
    ("OrbitArchiveNotWriting", archive("0+100x60", "0+1x60", "0x60")),
    ("OrbitHeartbeatGone", alive("0+10x16 160x60", "0+100x16 1600x60")),  # hangs from 160 s on
    ("OrbitHeartbeatGone", {**alive("_", "0x60"), "orbitfb_uptime_seconds": "5+10x60"}),
    ("OrbitHeartbeatGone", {"something_else": "1x60"}),
)
"""Other ways in which one fires."""
