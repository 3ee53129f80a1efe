"""A random forest on features made by hand, trained on cases of the generator itself.

It sees the same functional forms that it is tested on, which the diagnosis does not: an advantage.
"""

from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orbitfb.physics.places import Ring
from tests.blind.baselines.residual import Array, Naive
from tests.blind.cases import Spec, make
from tests.blind.draft import MAKERS, known

TRAINING_SEED = 77_000
"""Far from any seed of a suite."""


def features(record: Naive) -> Array:
    """Describe a record in about forty numbers."""
    white, action, time = record.white, record.action, record.arrays["t"]
    values: list[float] = []
    for lag in range(6):
        moved = record.predicted[: len(white) - lag] / record.level
        later = white[lag:]
        by_bpm = np.sum(moved * later, axis=0) / np.sqrt(np.sum(moved**2, axis=0) + 1e-30)
        values += [float(np.mean(by_bpm)), float(np.max(np.abs(by_bpm)))]
    for lag in range(1, 5):
        product = np.mean(white[lag:] * white[:-lag], axis=0)
        values += [float(np.mean(product)), float(product.max()), float(product.min())]
    spread = np.std(white, axis=0)
    fourth = np.mean(white**4, axis=0) / spread**4
    values += [float(spread.max() / np.median(spread)), float(spread.min() / np.median(spread))]
    values += [float(fourth.max()), float(np.median(fourth)), float(np.abs(white).max())]
    for gains in (record.row_gains(), record.column_gains(), record.quadrupole_gains()):
        ranked = np.sort(gains)[::-1] if gains.size > 1 else np.zeros(2)
        values += [float(np.log1p(ranked[0])), float(np.log1p(ranked[1]))]
    power = np.abs(np.fft.rfft(white, axis=0)) ** 2 / len(white)
    values += [float(power[2:].max()), float(power.mean(axis=1)[2:].max())]
    left, size, _ = np.linalg.svd(white.T @ white / len(white))
    values += [float(size[0] / size[1]), float(1 / np.sum(left[:, 0] ** 4))]
    still = np.mean(record.arrays["next_orbit"] == record.arrays["orbit"], axis=0)
    values += [float(still.max()), float(still.mean())]
    energy = np.sum(white**2, axis=1)
    half = len(energy) // 2
    values += [
        float(energy.max() / energy.mean()),
        float(energy[half:].mean() / energy[:half].mean()),
    ]
    for course in (time, record.arrays["current"], record.arrays["gap"]):
        slope = np.gradient(course)
        slope = (slope - slope.mean()) / (slope.std() + 1e-30)
        values.append(float(np.abs(slope @ white).max() / np.sqrt(len(white))))
    values.append(float(np.log(np.mean(action**2))))
    return np.nan_to_num(np.array(values), nan=0.0, posinf=1e9, neginf=-1e9)


def _training_case(number: int, name: str, folder: Path) -> tuple[NDArray[np.float64], str]:
    rng = np.random.default_rng([TRAINING_SEED, number])
    effects = (name,) if name else ()
    wants_both = bool(name) and MAKERS[name].planes == "xy"
    spec = Spec(
        effects=effects,
        target=float(rng.choice([6.0, 12.0, 30.0])),
        planes="xy" if wants_both else "x",
        ring="first",
        dither=("passive", "white", "shaped")[number % 3],
        ticks=1500,
        later=0,
        seed=TRAINING_SEED + number,
    )
    return features(Naive(make(spec, folder, TRAINING_SEED).record, Ring.load())), name or "no gap"


def train(folder: Path, pool: Executor, repeats: int = 8) -> Any:
    """Make the training set (kept in a folder) and the forest; None when there is no library."""
    try:
        from sklearn.ensemble import RandomForestClassifier  # pyright: ignore
    except ImportError:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "training.npz"
    if not kept.exists():
        names = [name for name in known() for _ in range(repeats)] + [""] * (4 * repeats)
        made = list(pool.map(_training_case, range(len(names)), names, [folder] * len(names)))
        table, labels = np.stack([f for f, _ in made]), np.array([label for _, label in made])
        np.savez(kept, table=table, labels=labels)
    with np.load(kept, allow_pickle=False) as file:
        table, labels = file["table"], file["labels"]
    forest = RandomForestClassifier(500, class_weight="balanced", random_state=0, n_jobs=1)
    forest.fit(table, labels)
    return forest


def answer(record: Naive, forest: Any) -> dict[str, Any]:
    """Name the class that most trees vote for."""
    chances = forest.predict_proba(features(record)[None])[0]
    ranked = np.argsort(chances)[::-1]
    names = [str(forest.classes_[i]) for i in ranked]
    rows = [
        {"effect": name, "nats": float(np.log(chances[i] + 1e-9))}
        for name, i in zip(names, ranked, strict=True)
        if name != "no gap"
    ]
    if names[0] == "no gap":
        return {"state": "no_gap", "causes": [], "tournament": {"rows": rows}}
    cause = {
        "effect": names[0],
        "stage": MAKERS[names[0]].stage,
        "places": [],
        "parameters": {},
        "probability": float(chances[ranked[0]]),
        "alternatives": [],
    }
    return {"state": "named", "causes": [cause], "tournament": {"rows": rows}}
