"""Write the dashboards: `python -m deploy.grafana.generate`; a test compares."""

import json
from pathlib import Path

from deploy.grafana.dashboard import Dashboard, dashboard_json
from deploy.grafana.gap import GAP
from deploy.grafana.learning import LEARNING
from deploy.grafana.loop import LOOP
from deploy.grafana.shift import SHIFT

TARGET = Path(__file__).parent / "dashboards"
DASHBOARDS: tuple[Dashboard, ...] = (SHIFT, LEARNING, GAP, LOOP)


def files() -> dict[str, str]:
    """Return the text of every dashboard by the name of its file."""
    return {
        f"{dashboard.name}.json": json.dumps(
            dashboard_json(dashboard), indent=2, ensure_ascii=False
        )
        + "\n"
        for dashboard in DASHBOARDS
    }


def main() -> None:
    """Write them."""
    TARGET.mkdir(exist_ok=True)
    for name, text in files().items():
        (TARGET / name).write_text(text, encoding="utf-8")
        print(f"deploy/grafana/dashboards/{name}")


if __name__ == "__main__":
    main()
