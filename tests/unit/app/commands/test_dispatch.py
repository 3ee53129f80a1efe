"""One implementation of every command, and a log of who gave it from where."""

from typing import Any, cast

import pytest
from structlog.testing import capture_logs

from orbitfb.app.commands.dispatch import Commands
from orbitfb.cli.options import pairs
from orbitfb.core.bursts import ONE_BY_ONE
from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import ConfigError, ControlError

PANEL = {"user": "jane", "host": "10.0.5.9", "pv": "SR:FB{Orbit}Command-Cmd"}
SOCKET = {"user": "root", "process": 17}


class Statistics:
    def __init__(self) -> None:
        self.lines: list[str] = []
        self.counted = 0

    def commanded(
        self, name: str, user: str, host: str, refusal: str = "", *, times: int = 1,
        told: bool = True,
    ) -> None:  # fmt: skip
        self.counted += times
        if told:
            self.lines.append(
                f"command: {name} by {user}@{host}" + (refusal and f" refused: {refusal}")
            )


def loop(request: Any) -> dict[str, Any]:
    if request["command"] == "reset":
        raise ControlError("there is nothing to reset")
    return {"done": request["command"]}


@pytest.fixture
def statistics() -> Statistics:
    return Statistics()


@pytest.fixture
def commands(statistics: Statistics) -> Commands:
    handlers = {"": loop, "gain": lambda request: {"gain": request["value"]}}
    return Commands(handlers, *cast(Any, (statistics, None)))


def test_a_command_of_either_door_is_carried_out_and_logged(commands: Commands, statistics: Any):
    with capture_logs() as logs:
        assert commands({"command": "close", "peer": SOCKET}) == {"done": "close"}
        assert commands({"command": "gain", "value": 0.5, "origin": PANEL, "peer": SOCKET}) == {
            "gain": 0.5
        }
    first, second = logs
    assert first == {
        **SOCKET,
        **{"event": "command_given", "command": "close", "host": "localhost"},
        **{"door": "socket", "log_level": "info"},
    }
    assert second == {
        **PANEL,
        **{"event": "command_given", "command": "gain", "with_value": 0.5, "door": "panel"},
        "log_level": "info",
    }
    assert statistics.lines == [
        "command: close by root@localhost",
        "command: gain by jane@10.0.5.9",
    ]


def test_what_is_refused_is_logged_with_the_reason(commands: Commands, statistics: Any):
    with capture_logs() as logs, pytest.raises(ControlError, match="nothing to reset"):
        commands({"command": "reset", "origin": PANEL})
    assert logs[0]["event"] == "command_refused" and logs[0]["log_level"] == "warning"
    assert (logs[0]["user"], logs[0]["reason"]) == ("jane", "there is nothing to reset")
    assert statistics.lines == [
        "command: reset by jane@10.0.5.9 refused: there is nothing to reset"
    ]


def test_a_write_that_the_panel_refused_is_logged_here(commands: Commands, statistics: Any):
    with capture_logs() as logs:
        assert commands({"command": "refused", "reason": "may not", "origin": PANEL}) == {}
    assert (logs[0]["event"], logs[0]["command"]) == ("command_refused", "write")
    assert statistics.lines == ["command: write by jane@10.0.5.9 refused: may not"]


def test_looking_is_not_logged(commands: Commands, statistics: Any):
    with capture_logs() as logs:
        commands({"command": "status", "peer": SOCKET})
    assert logs == [] and statistics.lines == []


def test_long_vectors_and_words_do_not_fill_the_log(commands: Commands):
    origin = {**PANEL, "user": "y" * 5000}
    with capture_logs() as logs:
        commands({"command": "reference", "values": [0.0] * 180, "origin": origin})
        commands({"command": "reference-save", "name": "x" * 5000, "origin": origin})
    assert logs[0]["with_values"] == "180 values"
    assert len(logs[1]["with_name"]) == len(logs[1]["user"]) == 300


def test_what_goes_with_a_command_on_the_command_line():
    typed = ["plane=x", "value=0.5", "enabled=[true,false]", "name=a=b", "policy=null"]
    assert pairs(typed) == {
        "plane": "x",
        "value": 0.5,
        "enabled": [True, False],
        "name": "a=b",
        "policy": None,
    }


@pytest.mark.parametrize("typed", ["plane", "=x", ""])
def test_what_is_no_pair(typed: str):
    with pytest.raises(ConfigError, match="give KEY=VALUE"):
        pairs([typed])


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        (
            {"command": "clsoe"},
            r"no command 'clsoe' \(did you mean close\?\); there are status,",
        ),
        (
            {"command": "gain", "value": 0.5, "vlaue": 1, "foo": 2},
            r"gain takes plane, value only: foo, vlaue \(did you mean value\?\)",
        ),
        ({"command": "close", "now": True}, "close takes nothing with it: now is unknown"),
        ({"command": "status", "extra": 1}, "status takes nothing with it: extra is unknown"),
    ],
)
def test_what_nobody_knows_is_refused(commands: Commands, request_: Any, words: str):
    with pytest.raises(ControlError, match=words):
        commands({**request_, "peer": SOCKET})


def test_who_floods_gets_one_line_per_quiet_time(statistics: Statistics):
    clock = ManualClock()
    commands = Commands({"": loop}, *cast(Any, (statistics, None)), clock=clock)
    refused = {"command": "refused", "reason": "may not", "origin": PANEL, "peer": SOCKET}
    with capture_logs() as logs:
        for _ in range(1000):
            commands(refused)
        clock.advance(10.0)
        commands({"command": "close", "peer": SOCKET})
    events = ["command_refused"] * ONE_BY_ONE + ["refusals_counted", "command_given"]
    assert [line["event"] for line in logs] == events
    assert (logs[-2]["source"], logs[-2]["count"]) == (PANEL["host"], 1000 - ONE_BY_ONE)
    assert statistics.counted == 1001
    assert len(statistics.lines) == ONE_BY_ONE + 1


def test_commands_of_an_operator_are_logged_one_by_one_until_they_flood(statistics: Statistics):
    clock = ManualClock()
    commands = Commands({"": loop}, *cast(Any, (statistics, None)), clock=clock)
    with capture_logs() as logs:
        for _ in range(3 * ONE_BY_ONE):
            commands({"command": "open", "origin": PANEL, "peer": SOCKET})
    assert len(logs) == ONE_BY_ONE
    with capture_logs() as logs:
        clock.advance(10.0)
        commands({"command": "close", "peer": SOCKET})
    assert logs[0]["event"] == "commands_counted"
    assert (logs[0]["last"], logs[0]["count"]) == ("open", 2 * ONE_BY_ONE)


def test_a_name_with_line_feeds_forges_no_line(commands: Commands, statistics: Statistics):
    forger = {**PANEL, "user": "x\n0:00:00 CLOSED\x1b[2J"}
    with capture_logs() as logs:
        commands({"command": "close", "origin": forger, "peer": SOCKET})
    assert logs[0]["user"].isprintable()
    assert all(line.isprintable() for line in statistics.lines)
