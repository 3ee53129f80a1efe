"""One implementation of every command, for two doors: the control socket and the panel.

The panel's process is a client of the control socket as the command line is one. Every command
is logged with who gave it and from where, and so is every one that was refused.
"""

from collections.abc import Callable, Mapping
from typing import Any

import structlog

from orbitfb.app.commands.requests import SILENT, check_request
from orbitfb.core.bursts import Bursts
from orbitfb.core.clock import SystemClock
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.core.ports import Clock
from orbitfb.core.printable import escaped
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.panel.figures import Figures

_log = structlog.stdlib.get_logger("orbitfb.control.server")

Handler = Callable[[Mapping[str, Any]], Mapping[str, Any]]

_LONGEST_WORD = 300
_MANY = 8


class Commands:
    """Answers requests of both doors; called from the control socket's threads.

    Args:
        handlers: By the name of the command; "" has those that no other one knows.
        statistics: Figures of the loop; gets a line for people.
        figures: What the panel shows.
        more: What it shows besides, by PV.
        clock: Tells the time; that of the computer by default.
    """

    def __init__(
        self,
        handlers: Mapping[str, Handler],
        statistics: LoopStatistics,
        figures: Figures,
        more: Callable[[], Mapping[str, Any]] = dict,
        clock: Clock | None = None,
    ) -> None:
        self._handlers = handlers
        self._statistics, self._figures, self._more = statistics, figures, more
        clock = clock or SystemClock()
        self._given = Bursts(clock)
        self._denied = Bursts(clock)

    def __call__(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        """Carry out a request.

        Raises:
            OrbitFeedbackError: It is refused; the message says why.
        """
        name = str(request.get("command"))
        self._tell_counts()
        if name == "panel":
            return self._panel()
        handler = self._handlers.get(name, self._handlers[""])
        if name in SILENT:
            check_request(request)
            return handler(request)
        who = origin_of(request)
        if name == "refused":
            times = request.get("times")
            times = times if isinstance(times, int) else 1
            self._refused("write", who, {}, _word(request.get("reason")), times)
            return {}
        told = _told(request)
        try:
            check_request(request)
            answer = handler(request)
        except OrbitFeedbackError as error:
            self._refused(name, who, told, str(error))
            raise
        told_now = self._given.add(_source(who), name)
        if told_now:
            _log.info("command_given", command=name, **told, **who)
        self._statistics.commanded(name, who["user"], who["host"], told=bool(told_now))
        return answer

    def _refused(
        self,
        name: str,
        who: Mapping[str, Any],
        told: Mapping[str, Any],
        reason: str,
        times: int = 1,
    ) -> None:
        told_now = self._denied.add(_source(who), reason, times)
        if told_now:
            many = {"count": times} if times > 1 else {}
            _log.warning("command_refused", command=name, reason=reason, **many, **told, **who)
        self._statistics.commanded(
            name, who["user"], who["host"], reason, times=times, told=bool(told_now)
        )

    def _tell_counts(self) -> None:
        """Tell what was counted of those who go on and on: one line each per quiet time."""
        for source, name, count in self._given.due():
            _log.info("commands_counted", source=source, last=name, count=count)
        for source, reason, count in self._denied.due():
            _log.warning("refusals_counted", source=source, reason=reason, count=count)

    def _panel(self) -> Mapping[str, Any]:
        snapshot = self._statistics.snapshot()
        more = self._more()
        return {
            "alive": self._figures.alive(snapshot),
            "figures": self._figures.values(snapshot, more),
        }


def origin_of(request: Mapping[str, Any]) -> dict[str, Any]:
    """Say who gave a command: user, host, and by which door.

    Args:
        request: `peer` was put in by the control socket, which knows it from the kernel;
            `origin` by the panel, which runs as the same user as the service.
    """
    peer, origin = request.get("peer"), request.get("origin")
    if isinstance(origin, Mapping):
        given = {key: _word(origin.get(key)) for key in ("user", "host", "pv")}
        return {**given, "door": "panel"}
    known = peer if isinstance(peer, Mapping) else {}
    return {
        "user": _word(known.get("user", "?")),
        "host": "localhost",
        "process": known.get("process"),
        "door": "socket",
    }


def _told(request: Mapping[str, Any]) -> dict[str, Any]:
    """Give what goes with a command as the log keeps it: vectors by their length."""
    told: dict[str, Any] = {}
    for key, value in request.items():
        if key in ("command", "origin", "peer"):
            continue
        many = isinstance(value, list) and len(value) > _MANY
        told[f"with_{key}"] = f"{len(value)} values" if many else _short(value)
    return told


def _short(value: Any) -> Any:
    plain = value is None or isinstance(value, bool | int | float)
    return value if plain else _word(value)


def _word(value: object) -> str:
    return escaped(str(value)[:_LONGEST_WORD])[:_LONGEST_WORD]


def _source(who: Mapping[str, Any]) -> str:
    """Name who is counted together: a host of the network, a user of this computer."""
    return str(who["host"] if who["door"] == "panel" else who["user"])
