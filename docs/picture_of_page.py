"""Draw the picture of the operator page: `.venv/bin/python docs/picture_of_page.py`.

Needs Debian's chromium. A loop runs for a minute against its simulated ring, with one BPM left out;
what the browser shows then is kept. With a directory as argument the pictures go there: besides the
one in the docs, that in the dark and that on a phone.
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import expect, sync_playwright

from orbitfb.control.client import ask

HOW_TO = Path(__file__).parent / "how-to"
OPTIONS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
)
PICTURES: dict[str, dict[str, Any]] = {
    "page.png": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "light"},
    "page-dark.png": {"viewport": {"width": 1280, "height": 900}, "color_scheme": "dark"},
    "page-phone.png": {"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"},
}
"""Window and scheme by name; `page.png` is in the docs, the others are made on demand."""
SETTLE = 60.0
"""How long the loop runs before [s]: until a refit has told the noise floor."""
LEFT_OUT = 3
"""Index of the BPM that is left out."""


def main() -> None:
    """Run a loop and draw its page."""
    chromium = shutil.which("chromium")
    if chromium is None:
        sys.exit("chromium is not installed: apt-get install chromium")
    place = Path(sys.argv[1]) if len(sys.argv) > 1 else HOW_TO
    names = PICTURES if place != HOW_TO else ("page.png",)
    with tempfile.TemporaryDirectory() as name:
        data = Path(name) / "data"
        words = [sys.executable, "-m", "orbitfb", "run", "--ioc", "sim", "--port", "0"]
        words += ["--metrics-port", "0", "--data", str(data)]
        environment = os.environ | {"ORBITFB_WEB__PORT": "0", "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(
            words, stdout=subprocess.PIPE, text=True, env=environment, start_new_session=True
        ) as service:
            try:
                address = _address(service)
                ask(data, {"command": "close"})
                enabled = [at != LEFT_OUT for at in range(180)]
                ask(data, {"command": "enable-bpms", "enabled": enabled})
                time.sleep(SETTLE)
                for picture in names:
                    draw(chromium, address, place / picture, PICTURES[picture])
            finally:
                service.terminate()
                service.wait(20)


def draw(chromium: str, address: str, path: Path, window: dict[str, Any]) -> None:
    """Open the page and keep what it shows."""
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as directory:
        browser = playwright.chromium.launch_persistent_context(
            directory, executable_path=chromium, args=list(OPTIONS), **window
        )
        page = browser.pages[0]
        page.goto(address)
        expect(page.locator("#live")).to_have_text("live", timeout=20_000)
        page.wait_for_timeout(2000)
        page.screenshot(path=path, full_page=True)
        browser.close()


def _address(service: subprocess.Popen[str]) -> str:
    for line in service.stdout or ():
        if line.startswith("operator page on "):
            return line.split()[-1]
    raise RuntimeError("the service told no address of its page")


if __name__ == "__main__":
    main()
