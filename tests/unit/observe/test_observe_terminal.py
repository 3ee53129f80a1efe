"""What the terminal shows: panel and lines, wide and narrow, whatever is known."""

import io
import math

import numpy as np
import pytest
import structlog
from observe_records import channels, feed, record, report
from rich.console import Console

from orbitfb.core.refit import Decision
from orbitfb.core.signals import LoopState
from orbitfb.observe.settings import TerminalSettings
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.observe.terminal import Terminal
from orbitfb.observe.view import STYLES, Surroundings, line, panel
from orbitfb.observe.wording import clock_time, micrometres, milliseconds, trend_line

AROUND = Surroundings("http://127.0.0.1:9180", 60.0, "simulated ring")


def draw(snapshot, width=80, height=24, trend=(), around=AROUND):
    console = Console(width=width, height=height, file=io.StringIO(), force_terminal=False)
    console.print(panel(snapshot, trend, around, (width, height)))
    return console.file.getvalue()


@pytest.fixture
def busy(statistics, clock):
    feed(statistics, clock, 100, error=(2.5e-7,) * 4, true=1e-7, latency=1.25e-3)
    clock.advance(0.25)
    statistics.refitted(report(Decision.PROMOTED))
    statistics.refitted(report(Decision.REFUSED, 2))
    return statistics


def test_the_panel_says_what_a_newcomer_asks_for(busy):
    text = draw(busy.snapshot(), trend=[250e-6, 1e-6, 2.5e-7])
    for expected in (
        "CLOSED for 0:00:10",
        "0.250 µm",
        "0.100 µm",
        "svd-1, swaps 0",
        "1 promoted, 1 refused, 0 rolled back",
        "refused: gains 0.3 %, less than 2 %",
        "100 at 10.0 Hz, missed 0",
        "p50 1.25 ms, p99 1.25 ms",
        "4 of 4 valid",
        "COR1 -2.00 of 18.0 A",
        "http://127.0.0.1:9180/metrics",
        "0:00:10 elapsed, 0:00:49 remaining",
        "█",
        "simulated ring",
    ):
        assert expected in text


@pytest.mark.parametrize("width", [26, 40, 59, 60, 80, 200])
@pytest.mark.parametrize("height", [5, 24])
def test_any_size_of_terminal_can_be_drawn(busy, width, height):
    busy(record(101, state=LoopState.HELD, reason="no orbit " * 20, lost=True))
    text = draw(busy.snapshot(), width, height, trend=[math.nan, 1e-6] * 100)
    assert all(len(row) <= width for row in text.splitlines())
    assert "HELD" in text


def test_trouble_beside_the_loop_is_seen_while_it_lasts(busy):
    trouble = ["the archive takes nothing"]
    around = Surroundings(trouble=lambda: "".join(trouble))
    assert "Trouble     the archive takes nothing" in draw(busy.snapshot(), around=around)
    trouble.clear()
    assert "Trouble" not in draw(busy.snapshot(), around=around)


def test_a_standard_terminal_holds_the_whole_panel(busy):
    assert len(draw(busy.snapshot(), 80, 24).splitlines()) <= 22


def test_before_the_first_tick_figures_are_dashes(statistics):
    text = draw(statistics.snapshot())
    assert "starting" in text
    assert "nan" not in text.lower()
    assert "nan" not in line(statistics.snapshot())


def test_markup_in_a_reason_is_only_text(statistics):
    statistics(record(1, state=LoopState.TRIPPED, reason="[bold]PV SR[/x] [red]"))
    assert "[bold]PV SR[/x] [red]" in draw(statistics.snapshot())


def test_every_state_has_a_colour():
    assert set(STYLES) == {None, *LoopState}


def test_plain_lines_tell_everything_that_happened(busy):
    busy(record(101, state=LoopState.HELD, reason="no orbit", policy_id="refit-0001", lost=True))
    busy.happened("archive", "the disk is full")
    stream = io.StringIO()
    terminal = Terminal(busy.snapshot, TerminalSettings(rate=20.0), AROUND, stream)
    terminal.start()
    terminal.stop()
    text = stream.getvalue()
    for expected in ("state: CLOSED\n", "state: HELD: no orbit\n", "policy: refit-0001 instead"):
        assert text.count(expected) == 1
    assert text.count("refit: refit-0002 refused: gains") == 1
    assert text.count("archive: the disk is full\n") == 1
    assert text.splitlines()[-1] == line(busy.snapshot())
    assert "\x1b" not in text


def test_live_gives_the_cursor_back(busy):
    stream = io.StringIO()
    terminal = Terminal(busy.snapshot, TerminalSettings(mode="live"), AROUND, stream)
    terminal.start()
    terminal.stop()
    terminal.stop()
    assert "CLOSED" in stream.getvalue()


def test_off_shows_nothing(busy):
    stream = io.StringIO()
    terminal = Terminal(busy.snapshot, TerminalSettings(mode="off"), AROUND, stream)
    terminal.start()
    terminal.stop()
    assert stream.getvalue() == ""


def test_a_terminal_that_goes_away_hurts_nobody(busy):
    class Gone(io.StringIO):
        def write(self, text):
            raise BrokenPipeError("gone")

    for mode in ("live", "plain"):
        terminal = Terminal(busy.snapshot, TerminalSettings(mode=mode), AROUND, Gone())
        with structlog.testing.capture_logs() as events:
            terminal.start()
            terminal.stop()
        assert [event["event"] for event in events] == ["terminal_status_failed"]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (249.7e-6, "250 µm"),
        (99.96e-6, "100 µm"),
        (12.34e-6, "12.3 µm"),
        (9.996e-6, "10.0 µm"),
        (1.234e-6, "1.23 µm"),
        (0.9996e-6, "1.00 µm"),
        (0.2434e-6, "0.243 µm"),
        (0.0, "0.000 µm"),
        (math.nan, "—"),
    ],
)
def test_lengths_have_three_digits(value, text):
    assert micrometres(value) == text


def test_durations():
    assert milliseconds(1.254e-3) == "1.25 ms"
    assert clock_time(3723.9) == "1:02:03"
    assert clock_time(-1.0) == "0:00:00"
    assert clock_time(2 * 86_400 + 61) == "2 d 0:01:01"


def test_the_trend_is_logarithmic_and_draws_noise_flat():
    assert trend_line([1e-3, 1e-4, 1e-5], 10) == "█▅▁"
    assert set(trend_line([1.00e-7, 1.02e-7, 1.01e-7], 10)) == {"▁"}
    assert trend_line([1e-3, math.nan, 1e-5], 10) == "█ ▁"
    assert trend_line([1.0, 2.0, 4.0], 2) == "▁█"
    assert trend_line([], 10) == ""
    assert trend_line([1.0], 0) == ""
    assert trend_line([0.0, math.nan], 5) == "  "


def test_masked_bpms_are_shown_as_masked_not_as_invalid(clock):
    statistics = LoopStatistics(channels(), 18.0, clock, np.array([True, False, True, True]))
    statistics(record(valid=(True, False, False, True)))
    assert "2 of 3 valid, 1 masked" in draw(statistics.snapshot())
