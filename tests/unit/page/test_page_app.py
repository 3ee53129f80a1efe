"""The page's application in this process: files, headers, who may look, reports."""

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote

import pytest
from page_parts import Service, filled, page_job
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from orbitfb.page import reports
from orbitfb.page.app import FILES, TOO_MANY, page_app

HOME = "http://127.0.0.1:9181"
OURS = {"host": "127.0.0.1:9181", "origin": HOME}


@contextlib.contextmanager
def browser(directory: Path, base: str = HOME, **web: object) -> Iterator[TestClient]:
    job = page_job(directory, **web)
    feed = filled(job, Service())
    with TestClient(page_app(job, feed), base_url=base) as client:
        yield client
    feed.close()


def report(directory: Path, name: str, text: str = "<p>it was a corrector</p>") -> Path:
    place = directory / f"{name}.diagnosis"
    place.mkdir(parents=True)
    (place / "report.html").write_text(text)
    (place / "diagnosis.json").write_text(json.dumps({"headline": f"headline of {name}"}))
    return place


def test_every_file_is_there_with_its_type_and_guarded(tmp_path: Path):
    with browser(tmp_path) as client:
        for path in ("", *FILES):
            got = client.get(f"/{path}")
            assert got.status_code == 200, path
            assert got.headers["content-type"].startswith(FILES[path or "index.html"])
            policy = got.headers["content-security-policy"]
            assert "default-src 'none'" in policy and "unsafe" not in policy
            assert got.headers["x-frame-options"] == "DENY"
            assert got.headers["x-content-type-options"] == "nosniff"
            assert got.headers["cache-control"] == "no-store"


def test_the_page_needs_nothing_from_elsewhere(tmp_path: Path):
    with browser(tmp_path) as client:
        whole = "".join(client.get(f"/{path}").text for path in FILES)
    assert whole.count("http://") == whole.count("http://www.w3.org/2000/svg")
    assert "https://" not in whole and "@ASSETS@" not in whole


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "PATCH", "OPTIONS"])
def test_it_is_read_only(tmp_path: Path, method: str):
    with browser(tmp_path) as client:
        assert client.request(method, "/").status_code == 405


@pytest.mark.parametrize("path", ["/etc/passwd", "/static/page.js", "/job.py", "/reports", "/docs"])
def test_nothing_else_is_there(tmp_path: Path, path: str):
    with browser(tmp_path) as client:
        got = client.get(path)
    assert got.status_code == 404
    assert "default-src 'none'" in got.headers["content-security-policy"]


@pytest.mark.parametrize("host", ["127.0.0.1:9181", "localhost", "[::1]:9181", "10.1.2.3", "ring"])
def test_it_is_known_by_addresses_and_names_of_ours(tmp_path: Path, host: str):
    with browser(tmp_path, names=("ring",)) as client:
        assert client.get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1.evil.example", "", "localhost@evil.example:1", "[::1"]
)
def test_a_name_that_is_not_ours_is_refused(tmp_path: Path, host: str):
    with browser(tmp_path) as client:
        assert client.get("/", headers={"host": host}).status_code == 421
        with (
            pytest.raises(WebSocketDisconnect),
            client.websocket_connect("/live", headers={"host": host}),
        ):
            pass


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "http://127.0.0.1:1", "http://127.0.0.1"]
)
def test_a_page_of_another_site_cannot_look(tmp_path: Path, origin: str):
    with (
        browser(tmp_path) as client,
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("/live", headers={"host": "127.0.0.1:9181", "origin": origin}),
    ):
        pass


def test_a_viewer_gets_the_ring_then_the_newest_picture(tmp_path: Path):
    with browser(tmp_path) as client, client.websocket_connect("/live", headers=OURS) as viewer:
        hello, picture = viewer.receive_json(), viewer.receive_json()
        page = client.get("/").text
    assert (hello["kind"], hello["layout"]["bpms"]) == ("hello", ["A", "B", "C"])
    assert hello["trend"] == [[100.0, 0.2, 1.0]]
    assert f'<meta name="assets" content="{hello["assets"]}">' in page
    assert picture["kind"] == "live" and picture["report"] is None


def test_one_viewer_too_many_is_told_so_and_a_place_gets_free(tmp_path: Path):
    with browser(tmp_path, viewers=1) as client:
        with client.websocket_connect("/live", headers=OURS) as first:
            first.receive_json()
            with client.websocket_connect("/live", headers=OURS) as second:
                with pytest.raises(WebSocketDisconnect) as told:
                    second.receive_json()
                assert told.value.code == TOO_MANY
        with client.websocket_connect("/live", headers=OURS) as third:
            assert third.receive_json()["kind"] == "hello"


def test_the_newest_report_is_named_and_shown_where_it_can_do_nothing(tmp_path: Path):
    old, new = report(tmp_path, "archive"), report(tmp_path / "archive", "segment")
    os.utime(old / "report.html", (1.0, 1.0))
    with browser(tmp_path) as client:
        with client.websocket_connect("/live", headers=OURS) as viewer:
            viewer.receive_json()
            named = viewer.receive_json()["report"]
        got = client.get(f"/reports/{named['name']}")
        other = client.get("/reports/archive.diagnosis")
    assert (named["name"], named["headline"]) == (new.name, "headline of segment")
    assert got.status_code == other.status_code == 200
    assert "it was a corrector" in got.text
    policy = got.headers["content-security-policy"]
    assert policy.startswith("sandbox; default-src 'none'") and "script-src" not in policy


def test_a_report_is_found_whatever_its_directory_is_called(tmp_path: Path):
    report(tmp_path, "archive").rename(tmp_path / "monday, 2nd try?")
    with browser(tmp_path) as client, client.websocket_connect("/live", headers=OURS) as viewer:
        viewer.receive_json()
        named = viewer.receive_json()["report"]
        got = client.get(f"/reports/{quote(named['name'])}")
    assert named["name"] == "monday, 2nd try?" and "it was a corrector" in got.text


def test_no_more_directories_than_the_bound_are_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(reports, "MOST", 3)
    for number in range(5):
        report(tmp_path, str(number))
    report(tmp_path, "odd").rename(tmp_path / os.fsdecode(b"no \xff text"))
    assert len(reports.find_reports(tmp_path)) == 3
    monkeypatch.setattr(reports, "MOST", 10)
    assert len(reports.find_reports(tmp_path)) == 5  # the odd name would fail in a browser


@pytest.mark.parametrize(
    "name",
    [
        "%2e%2e%2fsecret.diagnosis",
        "..%2fsecret.diagnosis",
        "archive.diagnosis%2freport.html",
        "archive.diagnosis/report.html",
        "archive.diagnosis%00",
        "linked.diagnosis",
        "inside.diagnosis",
        "half.diagnosis",
        ".hidden.diagnosis",
        "archive",
        "",
    ],
)
def test_only_reports_that_a_diagnosis_wrote_here_are_shown(tmp_path: Path, name: str):
    data = tmp_path / "data"
    report(data, "archive")
    secret = report(tmp_path, "secret", "secret")
    (data / "linked.diagnosis").symlink_to(secret)
    inside = report(data, "inside")
    (inside / "report.html").unlink()
    (inside / "report.html").symlink_to(secret / "report.html")
    (report(data, "half") / "diagnosis.json").unlink()
    report(data, ".hidden")
    with browser(data) as client:
        got = client.get(f"/reports/{name}")
    assert got.status_code == 404 and "secret" not in got.text


def test_a_damaged_answer_takes_only_its_headline(tmp_path: Path):
    place = report(tmp_path, "archive")
    (place / "diagnosis.json").write_text("{" * 100_000)
    with browser(tmp_path) as client, client.websocket_connect("/live", headers=OURS) as viewer:
        viewer.receive_json()
        assert viewer.receive_json()["report"]["headline"] == ""
