"""The page of the files names exactly the keys that real files have."""

import json
import re
from collections import deque
from dataclasses import asdict, fields

import h5py
import numpy as np
import pytest

from orbitfb.core.clock import ManualClock
from orbitfb.core.refit import Decision, RefitReport
from orbitfb.core.signals import Channels, LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.core.transitions import Transitions
from orbitfb.history.recorder import Recorder
from orbitfb.history.settings import ArchiveSettings
from orbitfb.learn.learner import Learner
from orbitfb.learn.settings import LearnSettings
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.observe.statistics.summary import summary
from orbitfb.physics.parameters import RingParameters
from orbitfb.physics.table import _NUMBERS, _READBACKS, _TEXTS, COLUMNS, KINDS
from orbitfb.policies.store.directory import PolicyStore
from orbitfb.policies.svd import SvdPolicy, SvdSettings

SIZE = 4
RESPONSE = np.diag([4.0, 3.0, 2.0, 1.0]) * 1e-4
NAMES = tuple(f"P{i}" for i in range(SIZE))
CHANNELS = Channels("x", NAMES, NAMES, NAMES, NAMES, NAMES)


@pytest.fixture
def tables(docs):
    """Rows of every table: heading -> header of its first column -> first column -> cells."""
    found, heading, header = {}, "", ""
    for line in (docs / "reference/files.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        elif row := re.match(r"\| `([^`]+)` \|(.*)\|$", line):
            cells = [cell.strip() for cell in row[2].split("|")]
            found.setdefault(heading, {}).setdefault(header, {})[row[1]] = cells
        elif line.startswith("| "):
            header = line.split("|")[1].strip()
    return found


def record():
    zeros = np.zeros(SIZE)
    orbit = Orbit(zeros, np.ones(SIZE, dtype=bool), 1e9)
    return TickRecord(
        tick=0,
        state=LoopState.CLOSED,
        reason="",
        reading=Reading(orbit, zeros, {"current": 0.4}, 1e9),
        reference=zeros,
        setpoints=zeros,
        requested=zeros,
        dither=zeros,
        applied=zeros,
        scale=1.0,
        written=1e9,
        policy_id="svd-0",
        phases=Phases(0.0, 0.0, 0.0, 0.0, 0.0),
        latency=1e-3,
        missed=0,
    )


def report(**changes):
    known = {
        "number": 1,
        "time": 1e9,
        "trigger": "periodic",
        "rows": 9,
        "decision": Decision.REFUSED,
        "reason": "",
        "policy_id": "svd-1",
        "incumbent_id": "svd-0",
        "figures": {},
        "duration": 0.1,
    }
    return RefitReport(**known | changes)


def test_archive_segment(tables, tmp_path):
    clock = ManualClock()
    recorder = Recorder(tmp_path, CHANNELS, ArchiveSettings(segment_megabytes=1), clock)
    recorder.write(deque([record()]))
    recorder.close()
    datasets = tables["Archive segment"]["dataset"]
    (path,) = tmp_path.glob("orbit-*.h5")
    with h5py.File(path) as file:
        assert set(tables["Archive segment"]["attribute"]) == set(file.attrs)
        found = {}
        file.visititems(
            lambda name, item: (
                found.update({name: item}) if isinstance(item, h5py.Dataset) else None
            )
        )
        assert set(datasets) == {n.replace("auxiliary/current", "auxiliary/NAME") for n in found}
        room = len(found["whole"])
        for name, item in found.items():
            shape, unit, _ = datasets[name.replace("auxiliary/current", "auxiliary/NAME")]
            assert unit == item.attrs.get("units", ""), name
            if not name.startswith("channels/"):
                assert item.shape == ((room, SIZE) if shape else (room,)), name


def test_policy_card_and_activations(tables, tmp_path):
    store = PolicyStore(tmp_path)
    policy = store.save(SvdPolicy(RESPONSE, SvdSettings()), CHANNELS)
    store.activate(policy)
    card = json.loads((tmp_path / policy / "card.json").read_text())
    active = json.loads((tmp_path / "active.json").read_text())
    assert set(tables["Policy card"]["key"]) == set(card)
    assert set(tables["Activations"]["key"]) == set(active)
    assert (tmp_path / policy / "policy.safetensors").is_file()


def test_summary(tables):
    statistics = LoopStatistics(CHANNELS, 17.5, ManualClock())
    statistics(record())
    statistics.refitted(report())
    made = summary(statistics.snapshot())
    keys = set()
    for name, value in made.items():
        deep = isinstance(value, dict) and name not in ("last_refit", "alarms", "state_entries")
        keys |= {f"{name}.{inner}" for inner in value} if deep else {name}
    assert set(tables["Summary"]["key"]) == keys
    last = set(re.findall(r"`(\w+)`", tables["Summary"]["key"]["last_refit"][0]))
    assert last == set(made["last_refit"])


def transitions(rows=120):
    """A closed loop with dither on a ring of four BPMs, all of it usable."""
    random = np.random.default_rng(1)
    policy = SvdPolicy(RESPONSE, SvdSettings())
    orbit, setpoints, noise = np.full(SIZE, 1e-6), np.zeros(SIZE), 2e-7
    columns = {"orbit": [], "applied": [], "dither": [], "setpoints": []}
    for _ in range(rows + 1):
        read = orbit + noise * random.standard_normal(SIZE)
        dither = 1e-3 * random.standard_normal(SIZE)
        change = dither - policy.gain_matrix @ read
        for name, value in zip(columns, (read, change, dither, setpoints), strict=True):
            columns[name].append(value)
        orbit = orbit + RESPONSE @ change + 4e-8 * random.standard_normal(SIZE)
        setpoints = setpoints + change
    made = {name: np.array(value) for name, value in columns.items()}
    time = 1e9 + 0.1 * np.arange(rows + 1)
    yes = np.ones(rows, dtype=bool)
    return Transitions(
        tick=np.arange(rows),
        time=time[:-1],
        next_time=time[1:],
        written=time[:-1] + 1e-3,
        orbit=made["orbit"][:-1],
        next_orbit=made["orbit"][1:],
        reference=np.zeros((rows, SIZE)),
        valid=np.ones((rows, SIZE), dtype=bool),
        requested=made["applied"][:-1],
        applied=made["applied"][:-1],
        dither=made["dither"][:-1],
        setpoints=made["setpoints"][:-1],
        readback=made["setpoints"][:-1],
        policy_id=np.full(rows, policy.policy_id),
        closed=yes,
        hertz=np.zeros(rows),
        usable=yes,
        auxiliary={},
    )


def test_refit_report_and_its_figures(tables):
    policy = SvdPolicy(RESPONSE, SvdSettings())
    learner = Learner(
        RESPONSE,
        LearnSettings(),
        lambda model, _: SvdPolicy(model.response, SvdSettings(), covariance=model.row_covariance),
    )
    made, _ = learner.refit(transitions(), policy, "on-demand")
    assert set(tables["Refit report"]["key"]) == set(asdict(made))
    assert set(tables["Refit report"]["key"]) == {field.name for field in fields(RefitReport)}
    of_several = {"gain_low", "gain_high"}  # there if more than one response was drawn
    of_rf = {"rf_ratio", "rf_ratio_low", "rf_ratio_high", "rf_steps"}  # if the RF is stepped
    assert set(tables["Judged figures"]["figure"]) == set(made.figures) | of_several | of_rf


def test_table_of_places(tables):
    columns = tables["Table of places"]["column"]
    assert tuple(columns) == COLUMNS
    for column, (needed, _) in columns.items():
        its = {
            kind: _NUMBERS[kind] + _TEXTS[kind] + (_READBACKS if kind == "COR" else ())
            for kind in KINDS
        }
        kinds = [kind for kind in KINDS if column in its[kind]]
        assert needed == (", ".join(kinds) or "all"), column


def test_ring_parameters(tables):
    assert set(tables["Ring parameters"]["parameter"]) == set(RingParameters.model_fields)
