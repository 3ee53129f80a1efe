"""Cut the pictures of a page out of a report: `.venv/bin/python docs/pictures_of_report.py ANSWER`.

ANSWER is what `orbitfb diagnose machine/archive --out ANSWER` wrote in the tutorial
`find-the-cause`. Needs Debian's chromium. The pictures go to `docs/how-to/diagnose`, or to the
directory that a second argument names.
"""

import shutil
import sys
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

PLACE = Path(__file__).parent / "how-to/diagnose"
WIDTH = 960
MARGIN = 8
CUTS = {
    "answer": ("h1", "#causes"),
    "orbit": ("#orbit", "#orbit"),
    "gap": ("#gap", "#gap figure:has-text('at which frequencies')"),
    "evidence": ("#evidence figure:has-text('What each effect explains')",) * 2,
}
"""Name of a picture -> where it begins and where it ends, each the first that fits."""


def cut(page: Page, first: str, last: str, file: Path) -> None:
    """Keep what stands from the top of one element to the bottom of another."""
    boxes = [page.locator(selector).first.bounding_box(timeout=5000) for selector in (first, last)]
    top, bottom = boxes
    if top is None or bottom is None:
        sys.exit(f"{file.name}: the report has no {first} or no {last}")
    begin = max(top["y"] - MARGIN, 0)
    end = bottom["y"] + bottom["height"] + MARGIN
    clip = {"x": 0, "y": begin, "width": WIDTH, "height": end - begin}
    page.screenshot(path=file, full_page=True, clip=clip)


def main() -> None:
    """Open the report and cut."""
    chromium = shutil.which("chromium")
    if chromium is None or len(sys.argv) < 2:
        sys.exit(__doc__ if chromium else "chromium is not installed: apt-get install chromium")
    place = Path(sys.argv[2]) if len(sys.argv) > 2 else PLACE
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": 900}, color_scheme="light")
        page.goto((Path(sys.argv[1]) / "report.html").resolve().as_uri())
        for name, (first, last) in CUTS.items():
            cut(page, first, last, place / f"{name}.png")
            print(place / f"{name}.png")
        browser.close()


if __name__ == "__main__":
    main()
