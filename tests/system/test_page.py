"""The page of a running service: what it says equals what the PVs say, however it is treated."""

import contextlib
import http.client
import json
import socket
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import psutil
import pytest
from ioc_clients import run_client
from service_process import CHANNELS, Service, fetch, wait_for
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from orbitfb.app.service.page_process import PageProcess
from orbitfb.config.tree import AppConfig
from orbitfb.control.client import ask
from orbitfb.core.clock import SystemClock
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.page.server import MORE_CONNECTIONS

pytestmark = pytest.mark.system

PREFIX = "PAGE:FB{Orbit}"
BPMS = CHANNELS.orbit_pvs[:5]
LISTEN = """
import json, os, time
os.environ["EPICS_CA_ADDR_LIST"] = "127.0.0.1:{ring} 127.0.0.1:{panel}"
import epics
seen = {{}}
def keep(pvname, value, timestamp, **_):
    number = value if isinstance(value, (int, float)) else None
    seen.setdefault(pvname, []).append([timestamp, number])
pvs = [epics.PV(name, callback=keep, auto_monitor=True) for name in {names!r}]
time.sleep({seconds})
texts = {{pv.pvname: pv.get(as_string=True) for pv in pvs}}
print(json.dumps([seen, texts]), flush=True)
os._exit(0)
"""


def start(directory: Path, *options: object, page: int = 0, watch: bool = False) -> Service:
    config = directory / "config.toml"
    config.write_text(
        f"""
        [web]
        viewers = 3
        [panel]
        enabled = true
        port = 0
        period = 0.05
        prefix = "{PREFIX}"
        """
    )
    return Service(directory / "data", "sim", "--config", config, *options, page=page, watch=watch)


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """A loop that ticks more slowly than the page and the panel look; the tests are one story."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    where = tmp_path_factory.mktemp("page")
    with start(where, "--rate", "2", page=port, watch=True) as service:
        service.wait_state("CLOSED")
        yield service


def look(service: Service) -> ClientConnection:
    where = service.where["page"].replace("http://", "ws://")
    return connect(f"{where}live", compression=None, open_timeout=5.0)


def pictures(viewer: ClientConnection, seconds: float) -> list[dict[str, Any]]:
    end = time.monotonic() + seconds
    found = [json.loads(viewer.recv(5.0))]
    while time.monotonic() < end:
        found.append(json.loads(viewer.recv(5.0)))
    return [its for its in found if its["kind"] == "live"]


def test_the_service_says_where_the_page_is(service: Service):
    assert f"operator page on {service.where['page']}\n" in service.out
    assert "<title>" in fetch(service.where["page"])


def test_what_it_shows_equals_what_the_pvs_say(service: Service):
    panel = int(service.where["panel"].split(":")[1])
    names = ["State-I", "Reason-I", "Policy-I", "RmsX-I", "Ticks-I", "GapText-I"]
    wanted = [PREFIX + name for name in names] + list(BPMS)
    with look(service) as viewer:
        hello = json.loads(viewer.recv(5.0))
        ask(service.data, {"command": "open"})  # setpoints stand still
        script = LISTEN.format(ring=service.port, panel=panel, names=wanted, seconds=8.0)
        pvs, texts = run_client(panel, script)
        shown = pictures(viewer, 0.5)
    assert hello["layout"]["bpms"] == list(CHANNELS.bpms)
    # every reading of the ring that came while both looked, by its stamp; a late tick shows none
    stamps = {round(its["stamp"], 3): its["orbit_um"] for its in shown if its["stamp"] is not None}
    compared = 0
    for number, name in enumerate(BPMS):
        for stamp, value in pvs[name]:
            if round(stamp, 3) in stamps:
                assert stamps[round(stamp, 3)][number] == pytest.approx(1e3 * value, abs=6e-4)
                compared += 1
    assert compared >= 4 * len(BPMS)
    # the panel's figures: each was on the page too, but for ticks at which either looked away
    rms = {round(its["rms_um"]["x"], 6) for its in shown if its["rms_um"]["x"] is not None}
    told = {round(value, 6) for _, value in pvs[f"{PREFIX}RmsX-I"][1:-1]}
    assert len(told & rms) >= 5 and len(told - rms) <= max(1, len(told) // 4)
    last = shown[-1]
    for name, value in (
        ("State-I", last["state"]),
        ("Reason-I", last["reason"]),
        ("Policy-I", last["policy"]),
        ("GapText-I", last["gap"]["headline"]),
    ):
        assert texts[PREFIX + name] == value, name
    ticks = pvs[f"{PREFIX}Ticks-I"][-1][1]
    assert min(abs(its["ticks"] - ticks) for its in shown) <= 1
    assert last["command"]["did"] == "opened" and "@localhost" in last["command"]["by"]


def test_setpoints_are_those_of_the_ring(service: Service):
    names = list(CHANNELS.setpoint_pvs)
    script = LISTEN.format(ring=service.port, panel=service.port, names=names, seconds=1.5)
    pvs, _ = run_client(service.port, script)
    with look(service) as viewer:
        last = pictures(viewer, 1.0)[-1]
    assert last["state"] == "OPEN"
    values = [pvs[name][-1][1] for name in names]
    assert last["setpoints_A"] == pytest.approx(values, abs=6e-6) and max(map(abs, values)) > 0.01


def test_one_viewer_too_many_is_turned_away_and_the_others_stay(service: Service):
    with ExitStack() as stack:
        viewers = [stack.enter_context(look(service)) for _ in range(3)]
        more = stack.enter_context(look(service))
        with pytest.raises(ConnectionClosed) as told:
            more.recv(5.0)
        assert told.value.rcvd is not None and told.value.rcvd.code == 4013
        assert all(pictures(viewer, 0.5) for viewer in viewers)
    with look(service) as viewer:
        assert pictures(viewer, 0.5)


def ask_raw(service: Service, request: bytes) -> bytes:
    where = urlsplit(service.where["page"])
    assert where.hostname and where.port
    with socket.create_connection((where.hostname, where.port), 5.0) as connection:
        connection.sendall(request)
        answer = b""
        with contextlib.suppress(TimeoutError, ConnectionError):
            while piece := connection.recv(65536):
                answer += piece
        return answer


@pytest.mark.parametrize(
    "path", [b"/../config.toml", b"/reports/../config.toml", b"/reports/..%2f..%2fconfig.toml",
             b"//etc/passwd", b"/reports/%2e%2e/config.toml"]
)  # fmt: skip
def test_no_path_leads_out_of_the_page(service: Service, path: bytes):
    host = urlsplit(service.where["page"]).netloc.encode()
    request = b"GET " + path + b" HTTP/1.1\r\nHost: " + host + b"\r\nConnection: close\r\n\r\n"
    answer = ask_raw(service, request)
    assert answer.startswith(b"HTTP/1.1 404") and b"viewers" not in answer


def test_nonsense_is_survived(service: Service):
    for request in (b"\x16\x03\x01\x02\x00", b"GET / HTTP/1.1", b"GET /" + b"a" * 70_000):
        assert b"400 Bad Request" in ask_raw(service, request + b"\r\n\r\n")
    with look(service) as viewer:
        viewer.send("close")  # nobody is told anything here
        with pytest.raises(ConnectionClosed):
            pictures(viewer, 5.0)
    with look(service) as viewer, contextlib.suppress(ConnectionClosed):
        viewer.send("x" * 100_000)
        pictures(viewer, 0.5)
    connection = http.client.HTTPConnection(urlsplit(service.where["page"]).netloc, timeout=5.0)
    connection.request("GET", "/", headers={"Host": "evil.example"})
    assert connection.getresponse().status == 421
    connection.close()
    assert "<title>" in fetch(service.where["page"])


def test_those_who_only_connect_give_way(service: Service):
    where = urlsplit(service.where["page"])
    with ExitStack() as stack, look(service) as viewer:
        for _ in range(4 * MORE_CONNECTIONS):
            stack.enter_context(socket.create_connection((where.hostname, where.port), 5.0))
        assert "<title>" in fetch(service.where["page"])
        assert pictures(viewer, 0.5)
    with ExitStack() as stack:  # viewers too many, who do not go when they are told to
        key = b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
        host = where.netloc.encode()
        shake = b"GET /live HTTP/1.1\r\nHost: " + host + b"\r\nUpgrade: websocket\r\n"
        for _ in range(2 * MORE_CONNECTIONS):
            deaf = stack.enter_context(socket.create_connection((where.hostname, where.port), 5.0))
            deaf.sendall(shake + b"Connection: Upgrade\r\n" + key + b"\r\n")
        assert "<title>" in fetch(service.where["page"])
    with look(service) as viewer:
        assert pictures(viewer, 0.5)


def test_a_service_that_is_killed_takes_its_page_along_and_the_next_one_takes_over(
    service: Service,
):
    page = service.child("orbitfb.page")
    with look(service) as viewer:
        began = pictures(viewer, 0.5)[-1]["started"]
        service.kill()
        with pytest.raises(ConnectionClosed):
            pictures(viewer, 10.0)
    page.wait(5.0)
    port = urlsplit(service.where["page"]).port
    assert port
    with start(service.data.parent, page=port) as second:
        assert second.where["page"] == service.where["page"]
        with look(second) as viewer:
            assert pictures(viewer, 0.5)[-1]["started"] > began
        page = second.child("orbitfb.page")
        second.stop()
        page.wait(5.0)


def test_a_page_comes_when_its_port_is_free_and_again_when_its_process_dies(tmp_path: Path):
    statistics = LoopStatistics(CHANNELS, 18.0, SystemClock())
    with socket.socket() as other, ExitStack() as stack:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        tree = {"data_directory": str(tmp_path), "web": {"port": port}}
        config = AppConfig.model_validate_json(json.dumps(tree))
        page = PageProcess(config, CHANNELS, statistics, stack)
        assert page.where == "" and f"127.0.0.1 port {port} is in use" in page.problem
        other.close()
        wait_for("page", lambda: page.where, 15.0)
        assert "<title>" in fetch(page.where) and page.problem == ""
        [child] = [its for its in psutil.Process().children() if "orbitfb.page" in its.cmdline()]
        child.kill()
        wait_for("its end", lambda: not page.where, 5.0)
        wait_for("another", lambda: page.where, 15.0)
        assert "<title>" in fetch(page.where)
    last = statistics.snapshot().happenings[-1]
    assert (last.kind, last.text) == ("page", "died: it said nothing")
