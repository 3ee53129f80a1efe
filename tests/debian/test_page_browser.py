"""The operator page in a real browser: it shows what the PVs say, and never an old picture as live.

Needs Debian's chromium; the browser is told to reach nothing but this computer.
"""

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from orbitfb.control.client import ask

pytestmark = pytest.mark.system

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium")
OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)
PREFIX = "WEB:FB{Orbit}"
PATIENCE = 20_000
"""How long a page may take to show something on a loaded computer [ms]."""

if CHROMIUM is None:
    pytest.skip("Debian's chromium is not installed", allow_module_level=True)


class Loop:
    """`orbitfb run` with page and panel on ports that stay the same from start to start."""

    def __init__(self, directory: Path) -> None:
        self.data, self._config = directory / "data", directory / "config.toml"
        with socket.socket() as one:
            one.bind(("127.0.0.1", 0))
            self.port = one.getsockname()[1]
        self._config.write_text(
            f"[web]\nport = {self.port}\n[panel]\nenabled = true\nport = 0\nperiod = 0.1\n"
            f'prefix = "{PREFIX}"\n[loop]\nrate_hz = 2.0\n[sim]\nrate_hz = 2.0\n'
        )
        self._out = directory / "out.txt"
        self.process: subprocess.Popen[bytes] | None = None
        self.url = f"http://127.0.0.1:{self.port}/"

    def start(self) -> None:
        words = [sys.executable, "-m", "orbitfb", "run", "--ioc", "sim", "--port", "0"]
        words += ["--metrics-port", "0", "--data", str(self.data), "--config", str(self._config)]
        with self._out.open("wb") as out:
            self.process = subprocess.Popen(words, stdout=out, stderr=out, start_new_session=True)
        deadline = time.monotonic() + 60.0
        while "archive, policies" not in self._out.read_text():
            assert self.process.poll() is None and time.monotonic() < deadline, (
                self._out.read_text()
            )
            time.sleep(0.05)
        said = self._out.read_text()
        assert f"operator page on {self.url}\n" in said, said
        self.panel = int(re.findall(r"panel of the PVs .* on 127\.0\.0\.1:(\d+)", said)[0])

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait(10)

    def stop(self) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            self.process.wait(20)


def pvs(port: int, *names: str) -> dict[str, str]:
    """Read PVs of the panel as text, with pyepics in a process of its own."""
    script = (
        "import epics, json, os\n"
        f"names = {[PREFIX + name for name in names]!r}\n"
        "print(json.dumps([epics.caget(n, as_string=True, timeout=5.0) for n in names]))\n"
        "import sys; sys.stdout.flush(); os._exit(0)\n"
    )
    network = {
        "EPICS_CA_ADDR_LIST": "127.0.0.1",
        "EPICS_CA_AUTO_ADDR_LIST": "NO",
        "EPICS_CA_SERVER_PORT": str(port),
        "EPICS_CA_REPEATER_PORT": str(port + 1),
    }
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=os.environ | network,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    return dict(zip(names, json.loads(done.stdout.splitlines()[-1]), strict=True))


@pytest.fixture(scope="module")
def loop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Loop]:
    """A running loop; the tests are one story, in order."""
    loop = Loop(tmp_path_factory.mktemp("browser"))
    try:
        loop.start()
        yield loop
    finally:
        loop.stop()


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        yield playwright.chromium


@contextmanager
def browser(chromium: Any, **options: Any) -> Iterator[Any]:
    """A page of a new browser; an error in it, or a request beyond this computer, fails."""
    with tempfile.TemporaryDirectory(prefix="orbitfb-chromium-") as directory:
        context = chromium.launch_persistent_context(
            directory, executable_path=CHROMIUM, args=list(OPTIONS), **options
        )
        page, errors, asked = context.pages[0], [], []
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
        page.on("request", lambda its: asked.append(its.url))
        try:
            yield page
        finally:
            context.close()
    unexpected = [error for error in errors if "ERR_CONNECTION_REFUSED" not in error]
    beyond = [url for url in asked if "//127.0.0.1:" not in url]
    assert asked and not unexpected and not beyond, (unexpected, beyond)


def live(page: Any) -> None:
    sync_api.expect(page.locator("#live")).to_have_text("live", timeout=PATIENCE)


def text(page: Any, name: str) -> str:
    return page.locator(f"#{name}").inner_text()


def number(said: str) -> float:
    return float(said.split()[0])


def rounded(value: float) -> float:
    """What the page makes of a value: three digits that count."""
    digits = 3 if value < 0.9995 else 2 if value < 9.995 else 1 if value < 99.95 else 0
    return round(value, digits)


def test_it_shows_what_the_pvs_say(loop: Loop, chromium: Any):
    with browser(chromium, viewport={"width": 1280, "height": 900}) as page:
        page.goto(loop.url)
        live(page)
        sync_api.expect(page.locator("#state")).to_have_text("CLOSED", timeout=PATIENCE)
        for state, command in (("CLOSED", None), ("OPEN", "open")):
            if command:
                ask(loop.data, {"command": command})
                sync_api.expect(page.locator("#state")).to_have_text(state, timeout=PATIENCE)
                time.sleep(0.3)
            names = ("State-I", "Reason-I", "Policy-I", "GapText-I", "RmsX-I", "Missed-I")
            for _ in range(10):  # a tick may come between looking here and there
                before = number(text(page, "rms-x"))
                told = pvs(loop.panel, *names)
                after = number(text(page, "rms-x"))
                shown = {
                    "State-I": text(page, "state"),
                    "Reason-I": text(page, "reason"),
                    "Policy-I": text(page, "policy"),
                    "GapText-I": text(page, "gap"),
                    "Missed-I": text(page, "missed"),
                }
                if rounded(float(told["RmsX-I"])) in (before, after):
                    break
            else:
                pytest.fail(f"the page never showed the rms of the PV: {before}, {told}")
            assert shown == {name: told[name] for name in shown}
        assert re.match(r"Opened by \S+@localhost, \d\d:\d\d:\d\d", text(page, "who"))
        ask(loop.data, {"command": "close"})


def test_bad_bpms_are_named_and_marked(loop: Loop, chromium: Any):
    with browser(chromium) as page:
        page.goto(loop.url)
        live(page)
        enabled = [at != 3 for at in range(180)]
        ask(loop.data, {"command": "enable-bpms", "enabled": enabled})
        note = page.locator("#error-x-note")
        sync_api.expect(note).to_have_text(re.compile(r"○ left out: \S+"), timeout=PATIENCE)
        sync_api.expect(page.locator("#bpms")).to_have_text("179 of 180")
        label = re.compile(r"Orbit error x .*; largest .* µm.*; ○ left out: ")
        sync_api.expect(page.locator("#error-x")).to_have_attribute(
            "aria-label", label, timeout=PATIENCE
        )
        ask(loop.data, {"command": "enable-bpms", "enabled": [True] * 180})
        sync_api.expect(note).to_have_text("", timeout=PATIENCE)


def test_a_report_is_linked_and_can_do_nothing(loop: Loop, chromium: Any):
    place = loop.data / "archive.diagnosis"
    place.mkdir()
    (place / "diagnosis.json").write_text('{"headline": "corrector <b>CH1A</b> has half its gain"}')
    (place / "report.html").write_text(
        "<h1 id='head'>Diagnosis</h1><script>document.getElementById('head').remove()</script>"
    )
    with browser(chromium) as page:
        page.goto(loop.url)
        live(page)
        report = page.locator("#report")
        sync_api.expect(report).to_contain_text("corrector <b>CH1A</b> has", timeout=PATIENCE)
        address = page.locator("#report a").get_attribute("href")
        assert address == "reports/archive.diagnosis"
        answer = page.request.get(loop.url + address)
        assert answer.ok and "sandbox" in answer.headers["content-security-policy"]


def luminance(page: Any) -> float:
    colour = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    return sum(int(part) for part in re.findall(r"\d+", colour)[:3]) / 3


def test_it_is_dark_in_the_dark_and_fits_a_phone(loop: Loop, chromium: Any):
    phone = {"viewport": {"width": 360, "height": 740}, "device_scale_factor": 2, "has_touch": True}
    with browser(chromium, **phone, color_scheme="dark") as page:
        page.goto(loop.url)
        live(page)
        assert luminance(page) < 40
        page.emulate_media(color_scheme="light")
        assert luminance(page) > 200
        wide = page.evaluate("() => document.documentElement.scrollWidth")
        assert wide <= 360, "the page must not scroll sideways"
        sync_api.expect(page.locator("#state")).to_be_in_viewport()
        sync_api.expect(page.locator("#rms-x")).to_be_in_viewport()
        page.locator("#error-x").tap()
        touched = re.compile(r"^[+−].* at \S+")  # what is under the finger, not the largest
        sync_api.expect(page.locator("#error-x-readout")).to_have_text(touched)


def test_an_old_picture_never_looks_live_and_the_page_comes_back(loop: Loop, chromium: Any):
    with browser(chromium) as page:
        page.goto(loop.url)
        live(page)
        assert loop.process is not None
        loop.process.send_signal(signal.SIGSTOP)  # it hangs: the page's own process goes on
        try:
            sync_api.expect(page.locator("#state")).to_have_text("NOT LIVE", timeout=PATIENCE)
            sync_api.expect(page.locator("#notice")).to_contain_text("did not answer")
        finally:
            loop.process.send_signal(signal.SIGCONT)
        live(page)
        loop.kill()
        sync_api.expect(page.locator("#state")).to_have_text("NOT LIVE", timeout=PATIENCE)
        sync_api.expect(page.locator("#state-for")).to_contain_text("was ")
        sync_api.expect(page.locator("#notice")).to_contain_text("NOT LIVE")
        assert page.title().startswith("NOT LIVE")
        sync_api.expect(page.locator("#tick-age")).to_have_text(re.compile(r"^\d+ s ago$"))
        main = page.locator("main")
        sync_api.expect(main).to_have_css("filter", "grayscale(1)")
        try:
            loop.start()
            live(page)
            told = page.locator("#notice")
            sync_api.expect(told).to_contain_text("started again", timeout=PATIENCE)
            sync_api.expect(main).to_have_css("filter", "none")
        finally:
            loop.stop()
