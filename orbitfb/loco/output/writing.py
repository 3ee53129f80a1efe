"""Write the answer to a directory: JSON, tables, effects, page; all of them or none."""

import tempfile
from pathlib import Path

from orbitfb.core.errors import ExchangeError
from orbitfb.loco.output.effects import fragment
from orbitfb.loco.output.page import page
from orbitfb.loco.output.tables import corrections_csv, csv_of, fitted_csv
from orbitfb.loco.run import Result
from orbitfb.loco.schema import ResponseDiagnosis, document


def write(answer: ResponseDiagnosis, result: Result, directory: Path) -> tuple[Path, ...]:
    """Write all files; those of an earlier diagnosis are replaced once the new ones are whole.

    Args:
        answer: The answer.
        result: What it was made of.
        directory: Where; made when it is not there.

    Raises:
        ExchangeError: They cannot be written; those there are the old ones.
    """
    texts = {
        "diagnosis.json": document(answer),
        "report.html": page(answer, result),
        "bpms.csv": csv_of(answer.bpms),
        "correctors.csv": csv_of(answer.correctors),
        "quadrupoles.csv": csv_of(answer.quadrupoles),
        "skews.csv": csv_of(answer.skews),
        "outliers.csv": csv_of(answer.outliers),
        "correlations.csv": csv_of(answer.correlations),
        "corrections.csv": corrections_csv(answer),
        "fitted.csv": fitted_csv(result),
        "effect.toml": fragment(answer.findings, result, answer.headline),
    }
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".new.", dir=directory) as made:
            for name, text in texts.items():
                Path(made, name).write_text(text, encoding="utf-8")
            for name in texts:
                Path(made, name).replace(directory / name)
    except OSError as error:
        raise ExchangeError(
            f"--out {directory}: cannot be written ({error.strerror}); make room there, or name "
            "another directory"
        ) from error
    return tuple(directory / name for name in texts)
