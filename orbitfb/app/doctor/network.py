"""The EPICS environment and the ports that `orbitfb run` would take; nothing is sent anywhere."""

import errno
import os
import socket
from collections.abc import Iterator, Mapping

from orbitfb.app.doctor.finding import Finding, Verdict
from orbitfb.config.tree import AppConfig
from orbitfb.epics.settings import LOWEST_PORT

_ENVIRONMENT, _PORTS = "environment", "ports"
_PREFIXES = ("EPICS_CA_", "EPICS_CAS_", "ORBITFB_")
_MOST_SHOWN = 120


def look_at_environment(environment: Mapping[str, str] | None = None) -> Iterator[Finding]:
    """Look at the variables that steer Channel Access and the program."""
    variables = os.environ if environment is None else environment
    found = {name: variables[name] for name in sorted(variables) if name.startswith(_PREFIXES)}
    if not found:
        yield Finding(_ENVIRONMENT, "variables", Verdict.OK, "no EPICS_CA_… or ORBITFB_… is set")
    for name, value in found.items():
        shown = value if len(value) <= _MOST_SHOWN else f"{value[:_MOST_SHOWN]}…"
        problem, advice = _problem(name, value)
        verdict = Verdict.WARNING if problem else Verdict.OK
        told = f"{shown!r}{': ' if problem else ''}{problem}"
        yield Finding(_ENVIRONMENT, name, verdict, told, advice, {"value": value})


def _problem(name: str, value: str) -> tuple[str, str]:
    """Say what is wrong with a variable and what to do; nothing where nothing is."""
    if name == "EPICS_CA_AUTO_ADDR_LIST" and value.upper() not in ("YES", "NO"):
        return "neither YES nor NO", "libca takes anything but NO for YES; write YES or NO"
    if name.endswith("_SERVER_PORT") and not (
        value.isascii() and value.isdigit() and LOWEST_PORT <= int(value) < 65536
    ):
        return "no port for Channel Access", f"give one from {LOWEST_PORT} to 65535"
    if name.endswith("_MAX_ARRAY_BYTES") and not (value.isdigit() and int(value) >= 16384):
        return "no size from 16384 on", "unset it; the program reads scalars"
    return "", ""


def look_at_ports(config: AppConfig, running: bool) -> Iterator[Finding]:
    """Look at whether the ports of the service are free, by binding each of them for a moment.

    Args:
        config: Names them.
        running: Whether a service runs on the data directory: then it is the one that has them.

    The loop starts without metrics and without a page, and only `--ioc sim` needs the port of the
    simulated ring: these three do not fail.
    """
    if config.observe.enabled:
        yield _port("metrics", config.observe.host, config.observe.port, ("tcp",), running, False)
    if config.web.enabled:
        yield _port("page", config.web.host, config.web.port, ("tcp",), running, False)
    if config.panel.enabled:
        own = config.panel
        yield _port("panel", own.interface, own.port, ("tcp", "udp"), running, True)
    sim = config.sim
    yield _port("simulated ring", sim.interface, sim.port, ("tcp", "udp"), running, False)


def _port(
    check: str, host: str, port: int, kinds: tuple[str, ...], running: bool, needed: bool
) -> Finding:
    where = f"{host}:{port}"
    figures = {"host": host, "port": port}
    if port == 0:
        return Finding(_PORTS, check, Verdict.OK, f"{host}, any free one", figures=figures)
    tried = {kind: _taken(host, port, kind) for kind in kinds}
    taken = [kind for kind, number in tried.items() if number == errno.EADDRINUSE]
    problem = next((n for n in tried.values() if n not in (0, errno.EADDRINUSE)), 0)
    if problem:
        return Finding(
            _PORTS,
            check,
            Verdict.FAILED if needed else Verdict.WARNING,
            f"{where}: {os.strerror(problem)}",
            "name an address of this computer and a port from 1024 on",
            figures,
        )
    figures["free"] = not taken
    if not taken:
        return Finding(_PORTS, check, Verdict.OK, f"{where} is free", figures=figures)
    if running:
        return Finding(_PORTS, check, Verdict.OK, f"{where} is in use, a service runs",
                       figures=figures)  # fmt: skip
    return Finding(
        _PORTS,
        check,
        Verdict.FAILED if needed else Verdict.WARNING,
        f"{where} is in use ({', '.join(taken)})",
        "stop who has it (ss -lntup), or name another port (0: any free one)",
        figures,
    )


def _taken(host: str, port: int, kind: str) -> int:
    """Bind a port as the service would; 0, or the number of the error."""
    try:
        family, *_, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except OSError as error:
        return error.errno if error.errno and error.errno > 0 else errno.EADDRNOTAVAIL
    with socket.socket(family, socket.SOCK_STREAM if kind == "tcp" else socket.SOCK_DGRAM) as own:
        if kind == "tcp":
            own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            own.bind(address)
            if kind == "tcp":
                own.listen(1)
        except OSError as error:
            return error.errno or errno.EADDRNOTAVAIL
    return 0
