"""Ask a running service over HTTP whether it is well: for probes of containers and for people."""

import json
from typing import Annotated, Any

import typer

from orbitfb.cli.options import AsJson, ConfigFile, configure

LARGEST_ANSWER = 1 << 16
"""Most that is read of an answer [bytes]."""

_ANY = {"0.0.0.0": "127.0.0.1", "::": "::1"}


def health(
    config_file: ConfigFile = None,
    ready: Annotated[
        bool,
        typer.Option(
            "--ready", help="Ask whether the loop does its work, not only whether it is alive."
        ),
    ] = False,
    host: Annotated[
        str | None, typer.Option(help="Address of the service [observe.host of the configuration].")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="Port of the service [observe.port of the configuration]."
        ),
    ] = None,
    timeout: Annotated[
        float, typer.Option(min=0.1, max=600.0, help="Longest wait for the answer [s].")
    ] = 3.0,
    as_json: AsJson = False,
) -> None:
    """Ask the running service whether it is alive (exit code 0) or not (1)."""
    from orbitfb.core.errors import ConfigError

    observe = configure(config_file).observe if host is None or port is None else None
    if observe is not None:
        host = host or _ANY.get(observe.host, observe.host)
        port = port or observe.port
        if not observe.enabled:
            raise ConfigError("observe.enabled is false, so nobody answers; set it to true")
    if not host or not port:
        raise ConfigError(
            "observe.port is 0, any free port; the service printed which: give it with --port"
        )
    answer = probe(host, port, "/readyz" if ready else "/healthz", timeout)
    if as_json:
        print(json.dumps(answer))
    else:
        print(_sentence(answer, "ready" if ready else "alive"))
    raise typer.Exit(0 if answer["good"] else 1)


def probe(host: str, port: int, path: str, timeout: float) -> dict[str, Any]:
    """Ask an endpoint of the service; no answer, or one of somebody else, is a bad one.

    Args:
        host: Address or name.
        port: TCP port.
        path: `/healthz` or `/readyz`.
        timeout: For every step of the exchange [s].

    Returns:
        `good` (bool), `reason` (str), and what else the service says.
    """
    import http.client  # fifty milliseconds of every other command

    connection = http.client.HTTPConnection(host, port, timeout=timeout)  # minds no proxy
    try:
        connection.request("GET", path, headers={"Accept": "application/json"})
        reply = connection.getresponse()
        content = json.loads(reply.read(LARGEST_ANSWER))
        status = reply.status
    except (OSError, http.client.HTTPException) as error:
        return {"good": False, "reason": f"no answer from {host} port {port} ({error})"}
    except (ValueError, RecursionError):
        content, status = None, 0
    finally:
        connection.close()
    if not isinstance(content, dict) or not isinstance(content.get("good"), bool):
        reason = f"{host} port {port} answers, but is not orbitfb"
        return {"good": False, "reason": reason}
    return {**content, "good": content["good"] and status == http.client.OK}


def _sentence(answer: dict[str, Any], question: str) -> str:
    said = question if answer["good"] else f"not {question}"
    state = answer.get("state")
    what = answer.get("reason") or state or ("no tick yet" if answer["good"] else "")
    parts = [str(what).strip()]
    age = answer.get("last_tick_age_s")
    if answer["good"] and state and isinstance(age, int | float):
        parts.append(f"last tick {age:.2f} s ago")
    return f"{said}: {', '.join(part for part in parts if part)}"
