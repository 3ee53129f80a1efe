"""The JSON log: what is told, how often, and that every line is JSON."""

import json
import logging

import numpy as np
import pytest
import structlog
from observe_records import channels, record, report

from orbitfb.core.errors import OwnershipError
from orbitfb.core.refit import Decision
from orbitfb.core.signals import LoopState
from orbitfb.observe.event_log import EventLog
from orbitfb.observe.logs import configure_logs, log_is_open
from orbitfb.observe.settings import LogSettings


@pytest.fixture
def log(clock):
    return EventLog(channels(), clock, quiet_time=10.0)


def told(events):
    return [event["event"] for event in events]


def test_a_quiet_loop_writes_no_line_per_tick(log, clock):
    with structlog.testing.capture_logs() as events:
        for tick in range(1000):
            clock.advance(0.1)
            log(record(tick))
    assert told(events) == ["loop_state_changed", "policy_in_force"]


@pytest.mark.parametrize(
    ("state", "level"),
    [
        (LoopState.SHADOW, "info"),
        (LoopState.HELD, "warning"),
        (LoopState.TRIPPED, "error"),
        (LoopState.FAULT, "critical"),
    ],
)
def test_states_are_told_with_reason_and_severity(log, state, level):
    log(record(1))
    with structlog.testing.capture_logs() as events:
        log(record(2, state=state, reason="why"))
    assert events == [
        {
            "event": "loop_state_changed",
            "log_level": level,
            "tick": 2,
            "state": state,
            "before": LoopState.CLOSED,
            "reason": "why",
        }
    ]


def test_a_swap_names_both_policies(log):
    log(record(1))
    with structlog.testing.capture_logs() as events:
        log(record(2, policy_id="refit-0001"))
    assert told(events) == ["policy_swapped"]
    assert (events[0]["policy"], events[0]["before"]) == ("refit-0001", "svd-1")


def test_missed_orbits_are_told_at_once_then_summed_up(log, clock):
    log(record(0))
    with structlog.testing.capture_logs() as events:
        for tick in range(1, 151):  # 15 s, each tick misses one
            clock.advance(0.1)
            log(record(tick, missed=1))
        for tick in range(151, 300):  # quiet again: the rest is still told
            clock.advance(0.1)
            log(record(tick))
    assert told(events) == ["orbits_missed"] * 3
    assert sum(event["count"] for event in events) == 150
    assert events[0]["count"] == 1


def test_shortened_changes_tell_the_smallest_factor(log, clock):
    log(record(0))
    with structlog.testing.capture_logs() as events:
        for scale in (0.5, 0.1, 0.9):
            clock.advance(6.0)
            log(record(1, scale=scale))
    assert [(event["smallest_scale"], event["count"]) for event in events] == [(0.5, 1), (0.1, 2)]


def test_masked_bpms_are_named(log, clock):
    log(record(1))
    with structlog.testing.capture_logs() as events:
        log(record(2, valid=(True, False, True, True)))
        log(record(3, valid=(True, False, True, True)))
        clock.advance(11.0)
        log(record(4))
    assert [(event["bpms"], event["log_level"]) for event in events] == [
        (["BPM1"], "warning"),
        ([], "info"),
    ]


def test_of_bpms_that_are_masked_by_configuration_nothing_is_told(clock):
    log = EventLog(channels(), clock, 10.0, np.array([True, False, True, True]))
    log(record(1, valid=(True, False, True, True)))
    with structlog.testing.capture_logs() as events:
        log(record(2, valid=(True, False, True, True)))
        log(record(3, valid=(True, False, False, True)))
    assert [event["bpms"] for event in events] == [["BPM2"]]


def test_a_reason_that_changes_with_every_tick_does_not_flood(log, clock):
    with structlog.testing.capture_logs() as events:
        for tick in range(200):
            clock.advance(0.1)
            log(record(tick, state=LoopState.HELD, reason=f"no orbit for {tick} ticks"))
    assert told(events).count("loop_reason_changed") == 2


def test_refits_are_told_with_figures(log):
    with structlog.testing.capture_logs() as events:
        log.refitted(report(Decision.PROMOTED, gain=0.98))
        log.refitted(report(Decision.ROLLED_BACK, 2))
    assert [event["log_level"] for event in events] == ["info", "warning"]
    assert events[0]["figures"] == {"gain": 0.98}
    assert events[0]["decision"] is Decision.PROMOTED


def lines(path):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    text = path.read_text(encoding="utf-8")
    return [json.loads(line, parse_constant=refuse) for line in text.splitlines()]


def test_the_file_is_json_lines_whatever_is_logged(tmp_path):
    logs = configure_logs(LogSettings(file="log/events.jsonl"), tmp_path)
    try:
        ours = structlog.stdlib.get_logger("orbitfb.test")
        ours.info("measured", rms=float("nan"), state=LoopState.HELD, text='quote " and\nline')
        ours.debug("too_fine")
        try:
            raise ValueError("bad value")
        except ValueError:
            ours.exception("failed")
            logging.getLogger("library").exception("theirs %s", "too")
        logging.getLogger("library").info("chatter")
    finally:
        logs.close()
    found = lines(tmp_path / "log/events.jsonl")
    assert told(found) == ["measured", "failed", "theirs too"]
    assert found[0]["rms"] is None
    assert found[0]["state"] == "HELD"
    assert found[0]["timestamp"].endswith("Z")
    assert all("ValueError: bad value" in event["exception"] for event in found[1:])
    assert [event["logger"] for event in found] == ["orbitfb.test", "orbitfb.test", "library"]


def test_a_log_is_open_from_when_it_is_set_up_until_it_is_closed(tmp_path):
    """Events that somebody captured are no log: an error would be told twice, once as an event."""
    with structlog.testing.capture_logs():
        pass
    assert structlog.is_configured()
    assert not log_is_open()
    logs = configure_logs(LogSettings(file="log/events.jsonl"), tmp_path)
    assert log_is_open()
    logs.close()
    assert not log_is_open()


def test_closing_puts_logging_back(tmp_path):
    root = logging.getLogger()
    before = root.level, list(root.handlers)
    logs = configure_logs(LogSettings(), tmp_path)
    logs.close()
    logs.close()
    assert (root.level, list(root.handlers)) == before


def test_a_full_file_is_put_aside(tmp_path):
    logs = configure_logs(LogSettings(largest=10_000, kept=2), tmp_path)
    for number in range(400):
        structlog.stdlib.get_logger("orbitfb.test").info("event", number=number)
    logs.close()
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == [
        "orbitfb.log.jsonl",
        "orbitfb.log.jsonl.1",
        "orbitfb.log.jsonl.2",
    ]
    assert all(file.stat().st_size <= 10_000 for file in files)
    assert lines(files[0])[-1]["number"] == 399


def test_a_file_that_cannot_be_opened_is_said(tmp_path):
    (tmp_path / "taken").write_text("")
    with pytest.raises(OwnershipError, match=r"log cannot be written to .*observe.logs.file"):
        configure_logs(LogSettings(file="taken/log.jsonl"), tmp_path)
