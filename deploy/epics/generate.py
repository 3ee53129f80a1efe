"""Write screens, alarm tree and archiver list: `python deploy/epics/generate.py`.

Another ring or prefix: `python deploy/epics/generate.py --config site.toml --out DIRECTORY`.
"""

import argparse
import sys
from pathlib import Path

from orbitfb.config.load import load_config
from orbitfb.core.errors import OrbitFeedbackError
from orbitfb.panel.pv_table import Extent, panel_pvs
from orbitfb.panel.site_files import site_files

HERE = Path(__file__).parent


def files(configuration: Path | None = None) -> dict[str, str]:
    """Give every file by its name, for a configuration."""
    config = load_config(configuration)
    channels = config.ring.load().channels(config.ring.planes)
    return site_files(config.panel.prefix, panel_pvs(config.panel, Extent.of(channels)))


def main() -> None:
    """Write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--config", type=Path, help="configuration of the service (TOML)")
    parser.add_argument("--out", type=Path, default=HERE, help="directory [beside this program]")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    try:
        written = files(chosen.config)
    except OrbitFeedbackError as error:
        sys.exit(f"generate.py: {error}")
    for name, text in written.items():
        (chosen.out / name).write_text(text, encoding="utf-8")
        print(chosen.out / name)


if __name__ == "__main__":
    main()
