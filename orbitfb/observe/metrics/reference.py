"""The page of the docs that lists all metrics."""

from orbitfb.observe.metrics.beam import BEAM
from orbitfb.observe.metrics.learning import LEARNING
from orbitfb.observe.metrics.loop import LOOP
from orbitfb.observe.metrics.service import DIAGNOSIS, SERVICE

_HEAD = """# Metrics

Served on `http://127.0.0.1:9180/metrics` (section `observe` of the configuration) while
`orbitfb run` runs. Base units; the words are those of the glossary. A figure that is not known
(no orbit came, nothing was written, a real ring has no true orbit) is left out of the scrape, so
that it is never mistaken for zero.

This page is written by `python -m orbitfb.observe.metrics.reference`; a test compares the two.
"""


def metrics_table_markdown() -> str:
    """Return the page of the docs that lists all metrics."""
    parts = [_HEAD]
    for title, metrics in (
        ("The loop", LOOP),
        ("Beam, BPMs and correctors", BEAM),
        ("Policies and the learner", LEARNING),
        ("Diagnosis", DIAGNOSIS),
        ("The service", SERVICE),
    ):
        rows = [
            f"\n## {title}\n",
            "| name | type | unit | labels | meaning |",
            "|---|---|---|---|---|",
        ]
        for metric in metrics:
            labels = ", ".join(f"`{label}`" for label in metric.labels)
            meaning = metric.help.replace("|", "\\|")
            rows.append(
                f"| `{metric.name}` | {metric.kind} | {metric.unit} | {labels} | {meaning} |"
            )
        parts.append("\n".join(rows) + "\n")
    return "".join(parts)


if __name__ == "__main__":
    import sys

    sys.stdout.write(metrics_table_markdown())
