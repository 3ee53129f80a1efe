"""Handing our reference to a fast feedback, over Channel Access: an IOC beside the ring."""

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from ioc_clients import run_client
from service_process import CONNECT, Ioc, Service, free_port, orbitfb, wait_for

from orbitfb.control.client import ask
from orbitfb.core.errors import ControlError
from orbitfb.sim.environment import server_environment

pytestmark = pytest.mark.system

FAST = """
import asyncio, sys
from caproto import ChannelDouble, ChannelInteger
from caproto.asyncio.server import Context
count, unit, limit = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
pvs = {
    "FOFB{Ref}X-SP": ChannelDouble(
        value=[0.0] * count, units=unit, lower_ctrl_limit=-limit, upper_ctrl_limit=limit
    ),
    "FOFB{Loop}Closed-I": ChannelInteger(value=1),
}



async def serve():
    await Context(pvs).run()


asyncio.run(serve())
"""


@contextmanager
def fast_feedback(count: int = 180, unit: str = "um", limit: float = 0.0) -> Iterator[int]:
    port = free_port()
    its = {"EPICS_CAS_SERVER_PORT": str(port), "EPICS_CA_SERVER_PORT": str(port)}
    environment = os.environ | server_environment(plain=False) | its
    script = [sys.executable, "-c", FAST, str(count), unit, str(limit)]
    with subprocess.Popen(
        script, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        try:
            yield port
        finally:
            process.terminate()


def settings(directory: Path, ring: Ioc, fast: int, **more: str) -> Path:
    config = directory / "c.toml"
    lines = "\n".join(f"{key} = {value}" for key, value in more.items())
    config.write_text(
        f"""
        [learn]
        enabled = false
        [lease]
        pv = ""
        [panel]
        enabled = true
        port = 0
        period = 0.1
        [loop]
        reference_speed = 2e-5
        [interlocks]
        fast_feedback_channel = "fofb"
        [fast_feedback]
        reference_pvs = {{ x = "FOFB{{Ref}}X-SP" }}
        interval = 0.2
        {lines}
        [epics]
        address_list = "127.0.0.1:{ring.port} 127.0.0.1:{fast}"
        connect_timeout = 10.0
        [epics.auxiliary]
        current = {{ pv = "SR:C03-BI{{DCCT:1}}I:Real-I", scale = 1e-3, stale_after = 10.0 }}
        fofb = {{ pv = "FOFB{{Loop}}Closed-I" }}
        """
    )
    return config


def caget(port: int) -> list[float]:
    return run_client(
        port,
        """
        import epics, json
        print(json.dumps(epics.caget("FOFB{Ref}X-SP").tolist()))
        """,
    )


def caput(port: int, pv: str, value: Any) -> None:
    run_client(
        port,
        f"""
        import epics, json
        print(json.dumps(epics.caput({pv!r}, {value!r}, wait=True)))
        """,
    )


def panel(service: Service, *names: str) -> list[Any]:
    port = int(service.where["panel"].split(":")[1])
    known = [f"SR:FB{{Orbit}}{name}" for name in names]
    return run_client(
        port,
        f"""
        import epics, json
        print(json.dumps([epics.caget(n, as_string=not n.endswith("Left-I")) for n in {known!r}]))
        """,
    )


def test_the_reference_is_handed_over_while_the_fast_feedback_is_closed(tmp_path: Path):
    with Ioc(tmp_path) as ring, fast_feedback() as fast:
        config = settings(tmp_path, ring, fast)
        options = ("--start", "open", "--config", config)
        with Service(tmp_path / "data", "config", *options) as service:
            wanted = [0.0] * 180
            wanted[3], wanted[90] = 20e-6, -7e-6
            ask(service.data, {"command": "reference", "values": wanted})
            assert panel(service, "HandOver-I") == ["OFF"]
            told = ask(service.data, {"command": "close"})
            assert told["hand_over"] == "HANDS OVER" and told["left_um"] == pytest.approx(20.0)
            assert service.status()["state"] == "OPEN"
            wait_for("it", lambda: is_there(service))
            found = caget(fast)
            assert found == pytest.approx([1e6 * each for each in wanted], abs=1e-3)
            assert service.events("hand_over_begun")

            caput(fast, "FOFB{Ref}X-SP", [5.0] * 180)  # somebody else
            wait_for("STOPPED", lambda: panel(service, "HandOver-I") == ["STOPPED"])
            [reason] = panel(service, "HandOverReason-I")
            assert "is not what was put" in reason and service.events("hand_over_stopped")
            assert caget(fast) == [5.0] * 180

            ask(service.data, {"command": "close"})
            wait_for("it again", lambda: is_there(service))
            ask(service.data, {"command": "open"})
            assert service.events("hand_over_ended")
            caput(fast, "FOFB{Loop}Closed-I", 0)
            wait_for("an open one", lambda: closes(service))
            service.wait_state("CLOSED")


def is_there(service: Service) -> bool:
    state, left = panel(service, "HandOver-I", "HandOverLeft-I")
    return state == "HANDS OVER" and left < 0.001


def closes(service: Service) -> bool:
    """Close the loop itself, once the fast feedback is known to be open."""
    try:
        return "hand_over" not in ask(service.data, {"command": "close"})
    except ControlError:
        return False


def nightly(*values: object) -> object:
    return pytest.param(*values, marks=pytest.mark.nightly)


@pytest.mark.parametrize(
    ("served", "more", "words"),
    [
        ({"count": 179}, {}, "FOFB{Ref}X-SP holds 179 values"),
        nightly({"count": 200}, {}, "FOFB{Ref}X-SP holds 200 values, of which 180 are named"),
        nightly({"unit": "counts"}, {}, "states counts"),
        ({"unit": "mm"}, {"unit": '"um"'}, "states mm"),
        ({}, {"interval": "0.0"}, "fast_feedback.interval"),
    ],
)
def test_an_array_that_cannot_take_it_is_told_before_anything_moves(
    tmp_path: Path, served, more, words
):
    with Ioc(tmp_path) as ring, fast_feedback(**served) as fast:
        config = settings(tmp_path, ring, fast, **more)
        if "interval" in more:
            config.write_text(config.read_text().replace("interval = 0.2\n", "", 1))
        done = orbitfb(
            "run", "--ioc", "config", "--config", config, "--data", tmp_path / "data",
            "--duration", 1, "--start", "open",
        )  # fmt: skip
        assert done.returncode != 0 and words in done.stderr, done.stderr


def test_a_reference_that_is_away_is_told_by_its_key(tmp_path: Path):
    with Ioc(tmp_path) as ring:
        config = settings(tmp_path, ring, free_port())
        done = orbitfb(
            "run", "--ioc", "config", "--config", config, "--data", tmp_path / "data",
            "--duration", 1, "--start", "open", **{CONNECT: "5"},
        )  # fmt: skip
        assert done.returncode != 0 and "fast_feedback.reference_pvs" in done.stderr, done.stderr
