"""The table of what options are worth: its rows, its figures, what becomes of failures."""

import json

import numpy as np
import pytest
import torch

from orbitfb.evaluate.ablation import Variant, ablate, variants


@pytest.fixture(autouse=True)
def _one_thread():
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def ring() -> np.ndarray:
    rng = np.random.default_rng(0)
    u, v = (np.linalg.qr(rng.standard_normal((12, 12)))[0] for _ in range(2))
    return (u * np.geomspace(3e-2, 3e-4, 12)) @ v.T


def test_rows_have_names_of_their_own_and_settings_that_exist() -> None:
    rows = list(variants(1, (1, 2)))
    names = [row.name for row in rows]
    assert len(set(names)) == len(names) > 30
    short = [
        Variant(row.name, row.group, row.form, {**row.change, "iterations": 1}, row.start)
        for row in rows
        if row.form in ("network", "structured")
    ]
    table = ablate(ring(), short, seeds=(0,), trajectories=2, steps=60)
    assert not [row["name"] for row in table["rows"] if "failed" in row]


@pytest.mark.nightly
def test_table_holds_what_the_laws_do() -> None:
    heard = []
    rows = [
        Variant("svd", "untrained", "svd"),
        Variant("modal", "untrained", "modal"),
        Variant("structured", "structured", "structured", {"iterations": 20}, "modal", True),
        Variant("hopeless", "full", "network", {"trained": "last"}),
    ]
    table = ablate(
        ring(), rows, seeds=(0, 1), trajectories=4, steps=100, spread=1e-7, told=heard.append
    )
    json.dumps(table, allow_nan=False)
    assert heard == [row.name for row in rows]
    svd, modal, structured, hopeless = table["rows"]
    assert modal["known"]["floor"]["median"] < svd["known"]["floor"]["median"]
    assert modal["known"]["steps"] == {"median": 1.0, "worst": 1.0}
    assert modal["others"]["diverged"]["worst"] == 0.0
    assert structured["known"]["floor"]["worst"] < 0.2e-6
    assert structured["processor_seconds"]["median"] > 0.0
    assert "start" in hopeless["failed"]
    assert "known" not in hopeless


def test_a_law_that_runs_away_is_counted_and_not_hidden() -> None:
    turned = {"iterations": 0, "output_scale": 10.0, "coordinates": "raw"}
    table = ablate(ring(), [Variant("wild", "full", change=turned)], seeds=(0,), trajectories=3)
    assert table["rows"][0]["known"]["diverged"]["worst"] == 1.0
    assert table["rows"][0]["known"]["steps"]["median"] is None
