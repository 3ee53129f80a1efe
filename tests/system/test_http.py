"""The HTTP endpoints over loopback, with kind, hostile and slow clients."""

import contextlib
import http.client
import json
import re
import socket
import threading
import time
import urllib.error
import urllib.request

import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import Channels, LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.observe import http as observe_http
from orbitfb.observe.bounded_http import MOST_CONNECTIONS
from orbitfb.observe.http import ObserveServer
from orbitfb.observe.metrics.collector import metrics_registry
from orbitfb.observe.settings import ObserveSettings
from orbitfb.observe.statistics.running import LoopStatistics

pytestmark = pytest.mark.system

NAMES = ("A", "B")


def tick(state=LoopState.CLOSED, reason=""):
    two = np.zeros(2)
    reading = Reading(Orbit(two + 1e-6, np.ones(2, bool), 1.0), two, {}, 0.0)
    phases = Phases(0.09, 0.0, 0.0, 0.0, 0.0)
    return TickRecord(
        1, state, reason, reading, two, two, two, two, two, 1.0, 2.0, "svd-1", phases, 1e-3, 0
    )


@pytest.fixture
def clock():
    return ManualClock()


@pytest.fixture
def statistics(clock):
    return LoopStatistics(Channels("x", NAMES, NAMES, NAMES, NAMES, NAMES), 18.0, clock)


@pytest.fixture
def server(statistics):
    server = ObserveServer(
        ObserveSettings(port=0, stale_after=5.0),
        metrics_registry(statistics.snapshot),
        statistics.snapshot,
    )
    server.start()
    yield server
    server.stop()


def get(server, path, method="GET"):
    """Return status, headers and body."""
    request = urllib.request.Request(server.address + path, method=method)
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(request, timeout=5.0) as answer:
            return answer.status, answer.headers, answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.headers, error.read()


def where(server):
    host, _, port = server.address.removeprefix("http://").rpartition(":")
    return host, int(port)


def say(server, request, wait=5.0):
    """Send raw bytes and return all that comes back."""
    with socket.create_connection(where(server), timeout=wait) as connection:
        connection.sendall(request)
        with contextlib.suppress(OSError):  # the server may have answered and hung up by now
            connection.shutdown(socket.SHUT_WR)
        answer = b""
        while piece := connection.recv(65_536):
            answer += piece
        return answer


def test_metrics_health_and_readiness(server, statistics, clock):
    assert server.address.startswith("http://127.0.0.1:")
    assert get(server, "/readyz")[0] == 503
    statistics(tick())
    status, headers, body = get(server, "/metrics")
    assert status == 200
    assert headers["Content-Type"].startswith("text/plain; version=")
    assert b"orbitfb_ticks_total 1.0" in body
    for path in ("/healthz", "/readyz", "/healthz?verbose=1"):
        status, headers, body = get(server, path)
        assert (status, headers["Content-Type"]) == (200, "application/json")
        assert json.loads(body)["good"] is True
    statistics(tick(LoopState.HELD, "no orbit"))
    status, _, body = get(server, "/readyz")
    assert (status, json.loads(body)["reason"]) == (503, "HELD: no orbit")
    assert get(server, "/healthz")[0] == 200
    clock.advance(6.0)
    assert get(server, "/healthz")[0] == 503


def test_head_has_no_body_and_the_length_of_one(server):
    status, headers, body = get(server, "/metrics", "HEAD")
    assert (status, body) == (200, b"")
    assert int(headers["Content-Length"]) > 1000
    assert get(server, "/", "HEAD")[0] == 200


@pytest.mark.parametrize(
    "path", ["/nothing", "/metrics/", "/../etc/passwd", "/%2e%2e/etc/passwd", "/<b>"]
)
def test_only_the_three_paths_exist(server, path):
    status, _, body = get(server, path)
    assert (status, body) == (404, b"not found\n")


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"])
def test_nothing_can_be_changed(server, method):
    status, headers, _ = get(server, "/metrics", method)
    assert (status, headers["Allow"]) == (405, "GET, HEAD")


def test_a_refused_body_is_answered_and_not_repeated(server):
    connection = http.client.HTTPConnection(*where(server), timeout=5.0)
    connection.request("POST", "/readyz", body=b"secret" * 5000)
    answer = connection.getresponse()
    assert (answer.status, b"secret" in answer.read()) == (405, False)
    connection.close()


@pytest.mark.parametrize(
    ("request_bytes", "code"),
    [
        (b"SECRET /metrics HTTP/1.1\r\n\r\n", b"501"),
        (b"GET SECRET SECRET SECRET\r\n\r\n", b"400"),
        (b"GET /SECRET HTTP/9.9\r\n\r\n", b"505"),
        (b"GET /" + b"SECRET" * 20_000 + b" HTTP/1.1\r\n\r\n", b"414"),
        (b"GET / HTTP/1.1\r\n" + b"SECRET: 1\r\n" * 500 + b"\r\n", b"431"),
        (b"POST / HTTP/1.1\r\nContent-Length: SECRET\r\n\r\n", b"405"),
        (b"POST / HTTP/1.1\r\nContent-Length: -5\r\n\r\n", b"405"),
    ],
)
def test_malformed_requests_get_an_error_without_an_echo(server, request_bytes, code):
    try:
        answer = say(server, request_bytes)
    except ConnectionResetError:  # hung up before all was read: allowed for what is too long
        assert len(request_bytes) > 65_536
    else:
        assert b" " + code + b" " in answer.split(b"\r\n", 1)[0]
        assert b"SECRET" not in answer
    assert get(server, "/")[0] == 200


@pytest.mark.timing
def test_slow_clients_do_not_block_the_others(server):
    slow = [socket.create_connection(where(server)) for _ in range(3 * MOST_CONNECTIONS)]
    try:
        for connection in slow[::2]:
            connection.sendall(b"GET /metr")
        before = time.monotonic()
        assert get(server, "/metrics")[0] == 200
        assert time.monotonic() - before < 2.0
        held = [t for t in threading.enumerate() if "process_request_thread" in t.name]
        assert len(held) <= 2 * MOST_CONNECTIONS  # those put out need a moment to end
    finally:
        for connection in slow:
            connection.close()


def test_a_client_that_leaves_before_the_answer_is_no_trouble(server, capsys):
    for _ in range(20):
        with socket.create_connection(where(server)) as connection:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
            connection.sendall(b"GET /metrics HTTP/1.1\r\n\r\n")
    assert get(server, "/metrics")[0] == 200
    assert capsys.readouterr().err == ""


def test_figures_that_fail_give_500_and_no_details(statistics):
    def broken():
        raise RuntimeError("SECRET")

    server = ObserveServer(ObserveSettings(port=0), metrics_registry(broken), broken)
    server.start()
    try:
        for path in ("/metrics", "/healthz"):
            status, _, body = get(server, path)
            assert status == 500
            assert b"SECRET" not in body
    finally:
        server.stop()


def test_a_port_in_use_is_told_and_taken_when_it_is_free(server, statistics, monkeypatch):
    monkeypatch.setattr(observe_http, "AGAIN_AFTER", 0.05)
    port = where(server)[1]
    second = ObserveServer(
        ObserveSettings(port=port), metrics_registry(statistics.snapshot), statistics.snapshot
    )
    second.start()
    assert re.search(rf"port {port} is in use.*observe.port \(--metrics-port", second.problem)
    assert second.address == ""
    server.stop()
    end = time.monotonic() + 5.0
    while second.problem and time.monotonic() < end:
        time.sleep(0.01)
    assert second.problem == "" and get(second, "/")[0] == 200
    second.stop()


def test_who_waits_for_a_port_can_be_stopped(server, statistics):
    second = ObserveServer(
        ObserveSettings(port=where(server)[1]),
        metrics_registry(statistics.snapshot),
        statistics.snapshot,
    )
    second.start()
    before = time.monotonic()
    second.stop()
    assert time.monotonic() - before < 1.0


@pytest.mark.parametrize("host", ["127.0.0.1:1", "localhost", "[::1]:9180", "10.1.2.3"])
def test_it_is_known_by_addresses_and_names_of_ours(server, host):
    assert answer_to(server, f"GET /healthz HTTP/1.1\r\nHost: {host}\r\n\r\n").startswith(
        b"HTTP/1.0 200"
    )


@pytest.mark.parametrize("path", ["/metrics", "/healthz", "/"])
def test_a_page_of_another_site_reads_nothing(server, path):
    told = answer_to(server, f"GET {path} HTTP/1.1\r\nHost: evil.example:9180\r\n\r\n")
    assert told.startswith(b"HTTP/1.0 421") and b"orbitfb_" not in told
    assert b"observe.names" in told


def answer_to(server, request):
    with socket.create_connection(where(server)) as client:
        client.settimeout(5.0)
        client.sendall(request.encode())
        return b"".join(iter(lambda: client.recv(65536), b""))


@pytest.mark.timing
def test_stopping_is_quick_and_frees_the_port(server, statistics):
    port = where(server)[1]
    with socket.create_connection(where(server)) as idle:
        idle.sendall(b"GET /")
        before = time.monotonic()
        server.stop()
        server.stop()
        assert time.monotonic() - before < 1.0
        idle.settimeout(2.0)
        with contextlib.suppress(ConnectionResetError):
            assert idle.recv(100) == b""
    again = ObserveServer(
        ObserveSettings(port=port), metrics_registry(statistics.snapshot), statistics.snapshot
    )
    again.start()
    assert where(again)[1] == port
    again.stop()


def test_disabled_serves_nothing(statistics):
    server = ObserveServer(
        ObserveSettings(enabled=False), metrics_registry(statistics.snapshot), statistics.snapshot
    )
    server.start()
    assert server.address == ""
    server.stop()


def test_many_scrapes_at_once(server, statistics):
    statistics(tick())
    codes = []

    def scrape():
        for _ in range(10):
            codes.append(get(server, "/metrics")[0])

    threads = [threading.Thread(target=scrape) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert codes == [200] * 80
