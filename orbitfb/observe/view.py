"""The status as people see it: a panel for the terminal, a line for everything else."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from orbitfb.core.printable import escaped
from orbitfb.core.refit import Decision
from orbitfb.core.signals import LoopState
from orbitfb.observe.statistics.snapshot import LoopSnapshot
from orbitfb.observe.wording import (
    UNKNOWN,
    clock_time,
    micrometres,
    milliseconds,
    time_of_day,
    trend_line,
)

STYLES = {
    None: "bold",
    LoopState.OPEN: "bold blue",
    LoopState.SHADOW: "bold cyan",
    LoopState.CLOSED: "bold green",
    LoopState.HELD: "bold yellow",
    LoopState.TRIPPED: "bold white on red",
    LoopState.FAULT: "bold white on red",
}

LABEL_WIDTH = 11
NARROW = 60
"""Below this width [characters] the panel keeps to what matters most."""
SHORT = 20
"""Below this height [lines] too."""


def no_trouble() -> str:
    """Say that nothing is wrong."""
    return ""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the panel says beside the figures.

    Args:
        metrics: Address of the metrics; empty when they are not served.
        duration: How long the run shall last [s]; None runs until it is stopped.
        ring: What the loop is connected to, in a few words.
        trouble: Says what is wrong beside the loop at present, with the archive for one; empty
            when nothing is.
    """

    metrics: str = ""
    duration: float | None = None
    ring: str = ""
    trouble: Callable[[], str] = no_trouble


def panel(
    snapshot: LoopSnapshot, trend: Sequence[float], around: Surroundings, size: tuple[int, int]
) -> Panel:
    """Draw the status.

    Args:
        snapshot: Figures of this moment.
        trend: Orbit RMS [m] in the past, one per second, oldest first.
        around: What else to say.
        size: Width and height of the terminal [characters].
    """
    width, height = size
    small = width < NARROW or height < SHORT
    rows = Table.grid(padding=(0, 1), expand=True)
    rows.add_column(style="dim", width=LABEL_WIDTH, no_wrap=True)
    rows.add_column(ratio=1, no_wrap=True, overflow="ellipsis")
    state = "starting" if snapshot.state is None else snapshot.state.value
    style = STYLES[snapshot.state]
    rows.add_row("State", Text.assemble((state, style), f" for {clock_time(snapshot.in_state)}"))
    if snapshot.reason:
        rows.add_row("", Text(escaped(snapshot.reason), style="yellow", no_wrap=False))
    if trouble := around.trouble():
        rows.add_row("Trouble", Text(escaped(trouble), style="yellow", no_wrap=small))
    _orbit_rows(rows, snapshot, trend, width - LABEL_WIDTH - 6)
    if not small:
        rows.add_row("")
    _policy_rows(rows, snapshot, small)
    if not small:
        rows.add_row("")
    _pace_rows(rows, snapshot, small)
    if around.metrics:
        rows.add_row("Metrics", Text(f"{around.metrics}/metrics"))
    rows.add_row("Time", Text(_time(snapshot, around)))
    ring = f" · {around.ring}" if around.ring and not small else ""
    return Panel(
        rows,
        title=Text(f"orbitfb{ring}"),
        subtitle=None if small else "Ctrl-C stops the loop; setpoints stay where they are",
        border_style=style.removeprefix("bold ") if snapshot.state else "dim",
        width=min(width, 100),
    )


def _orbit_rows(rows: Table, snapshot: LoopSnapshot, trend: Sequence[float], width: int) -> None:
    orbit = snapshot.orbit
    rows.add_row(
        "Orbit RMS",
        Text.assemble(
            (f"{micrometres(orbit.observed.now):<9}", "bold"),
            f"  10 s: {micrometres(orbit.observed.window):<9}",
            f"  at start: {micrometres(orbit.first)}",
        ),
    )
    if not math.isnan(orbit.true.window):
        rows.add_row(
            "True RMS",
            Text(
                f"{micrometres(orbit.true.now):<9}  10 s: {micrometres(orbit.true.window):<9}"
                "  without BPM noise"
            ),
        )
    rows.add_row("Trend", Text(trend_line(trend, min(width, 60)), style="cyan"))


def _policy_rows(rows: Table, snapshot: LoopSnapshot, small: bool) -> None:
    refits, last = snapshot.refits, snapshot.last_refit
    rows.add_row("Policy", Text(f"{snapshot.policy_id or UNKNOWN}, swaps {snapshot.swaps}"))
    rows.add_row(
        "Refits",
        Text(
            f"{refits[Decision.PROMOTED]} promoted, {refits[Decision.REFUSED]} refused, "
            f"{refits[Decision.ROLLED_BACK]} rolled back"
        ),
    )
    if last is not None:
        word = last.decision.value.replace("_", " ")
        rows.add_row(
            "Last refit", Text(f"{time_of_day(last.time)} {word}: {last.reason}", no_wrap=small)
        )


def _pace_rows(rows: Table, snapshot: LoopSnapshot, small: bool) -> None:
    ticks, latency = snapshot.ticks, snapshot.latency
    rate = UNKNOWN if math.isnan(ticks.period) else f"{1.0 / ticks.period:.1f} Hz"
    pace = f"{ticks.ticks} at {rate}, missed {ticks.missed}"
    if not small:
        pace += f", jitter {milliseconds(ticks.jitter)}"
    rows.add_row("Ticks", Text(pace))
    rows.add_row(
        "Latency", Text(f"p50 {milliseconds(latency.p50)}, p99 {milliseconds(latency.p99)}")
    )
    if small:
        return
    orbit, nearest = snapshot.orbit, snapshot.correctors
    wanted = orbit.bpms - orbit.masked
    bpms = f"{wanted - orbit.invalid} of {wanted} valid"
    if orbit.masked:
        bpms += f", {orbit.masked} masked"
    if orbit.worst_bpm:
        bpms += f", worst {orbit.worst_bpm} {micrometres(orbit.worst)}"
    rows.add_row("BPMs", Text(bpms))
    if nearest.name:
        rows.add_row(
            "Correctors",
            Text(
                f"nearest limit {nearest.name} {nearest.setpoint:.2f} of {nearest.limit:.1f} A, "
                f"limited ticks {nearest.limited}"
            ),
        )


def _time(snapshot: LoopSnapshot, around: Surroundings) -> str:
    elapsed = f"{clock_time(snapshot.duration)} elapsed"
    if around.duration is None:
        return elapsed
    return f"{elapsed}, {clock_time(around.duration - snapshot.duration)} remaining"


def line(snapshot: LoopSnapshot) -> str:
    """Write the status in one plain line."""
    orbit = snapshot.orbit
    state = "starting" if snapshot.state is None else snapshot.state.value
    parts = [
        f"{clock_time(snapshot.duration)} {state:<8}",
        f"orbit rms {micrometres(orbit.observed.now)}",
    ]
    if not math.isnan(orbit.true.now):
        parts.append(f"true {micrometres(orbit.true.now)}")
    parts += [
        f"ticks {snapshot.ticks.ticks}",
        f"missed {snapshot.ticks.missed}",
        f"latency p50 {milliseconds(snapshot.latency.p50)}",
        f"refits {snapshot.judged}",
        f"swaps {snapshot.swaps}",
        f"policy {snapshot.policy_id or UNKNOWN}",
    ]
    if snapshot.reason:
        parts.append(snapshot.reason)
    return escaped("  ".join(parts))
