"""The search over settings of the plain Algorithm 1: every combination once, the best first."""

import json

from benchmarks.algorithm_one import main

SMALL = ["--batches", "2", "--horizons", "1", "--seeds", "0,1", "--iterations", "2"]
SHORT = ["--trajectories", "1", "--steps", "100"]


def test_every_combination_is_run_once_and_the_best_end_comes_first(tmp_path, capsys):
    main(["--out", str(tmp_path), "--rates", "1e-4", *SMALL, *SHORT])
    assert "2 of 2" in capsys.readouterr().out
    main(["--out", str(tmp_path), "--rates", "1e-4,1e-3", *SMALL, *SHORT])
    assert "2 of 4" in capsys.readouterr().out  # those are there already
    rows = json.loads((tmp_path / "search.json").read_text())["rows"]
    assert {(row["rate"], row["seed"]) for row in rows} == {
        (1e-4, 0), (1e-4, 1), (1e-3, 0), (1e-3, 1),
    }  # fmt: skip
    ends = [row["final_rms_mm"] for row in rows]
    assert ends == sorted(ends)
