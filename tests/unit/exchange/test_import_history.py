"""Orbit histories from elsewhere, become records that `diagnose` reads."""

import json
from datetime import UTC, datetime

import h5py
import numpy as np
import pytest
import scipy.io

from orbitfb.cli.app import app
from orbitfb.core.errors import ExchangeError
from orbitfb.physics.places import Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.records.reading.load import load, load_record

RING = Ring.load()
CHANNELS = RING.channels("x")
TICKS, PERIOD, BEGIN = 60, 0.1, 1_790_000_000.0


@pytest.fixture(scope="module")
def shift():
    """Setpoints [A] and orbits [m] of 60 ticks of the simulated ring, one row per tick."""
    plant = Plant(RING, "x", PlantSettings(initial_orbit_rms=50e-6), seed=3)
    rng = np.random.default_rng(3)
    setpoints = np.cumsum(rng.normal(0, 0.02, (TICKS, 180)), axis=0)
    return setpoints, np.array([plant.step(row).reading for row in setpoints])


@pytest.fixture(autouse=True)
def _in_an_empty_directory(tmp_path, shift, monkeypatch):
    monkeypatch.chdir(tmp_path)


def taken(*arguments):
    assert app(["import", "history", *map(str, arguments)], standalone_mode=False) in (None, 0)
    return load_record("history.h5")


def refused(*arguments):
    with pytest.raises(ExchangeError) as caught:
        app(["import", "history", *map(str, arguments)], standalone_mode=False)
    return str(caught.value)


def archived(shift, lose=(), severity=None, egu="mm"):
    """What an archiver answers: BPMs of every tick, setpoints when they changed."""
    setpoints, orbits = shift
    answer = []
    for j, pv in enumerate(CHANNELS.orbit_pvs):
        data = [
            {"secs": int(nanos // 10**9), "nanos": int(nanos % 10**9), "val": 1e3 * orbits[k, j],
             "severity": (severity or {}).get((j, k), 0), "status": 0}
            for k in range(TICKS)
            if (j, k) not in lose
            for nanos in [int(BEGIN) * 10**9 + k * 10**8 + j * 10**4]
        ]  # fmt: skip
        answer.append({"meta": {"name": pv, "PREC": "4", "EGU": egu}, "data": data})
    for j, pv in enumerate(CHANNELS.setpoint_pvs):
        data = [
            {"secs": int(nanos // 10**9), "nanos": int(nanos % 10**9), "val": setpoints[k, j],
             "severity": 0, "status": 0}
            for k in range(TICKS)
            for nanos in [int(BEGIN) * 10**9 + k * 10**8 - 5 * 10**7]
        ]  # fmt: skip
        answer.append({"meta": {"name": pv, "PREC": "4", "EGU": "A"}, "data": data})
    return answer


def written(path, answer):
    path.write_text(json.dumps(answer))
    return path


def test_an_archiver_that_missed_nothing(tmp_path, shift):
    record = taken(written(tmp_path / "a.json", archived(shift)))
    setpoints, orbits = shift
    np.testing.assert_allclose(record.readings[: TICKS - 1], orbits[:-1], atol=1e-12)
    np.testing.assert_allclose(record.setpoints[: TICKS - 1], setpoints[:-1], atol=1e-12)
    np.testing.assert_allclose(
        record.requested[: TICKS - 1], np.diff(setpoints, axis=0), atol=1e-12
    )
    assert record.layout.period == pytest.approx(PERIOD)
    assert record.starts.sum() == 1


@pytest.mark.parametrize("missing", [None, "NaN"])
def test_a_sample_without_a_number_is_missing(tmp_path, shift, missing):
    answer = archived(shift)
    answer[5]["data"][20]["val"] = missing
    answer[3]["meta"]["EGU"] = "Millimeters"
    answer[200]["meta"]["EGU"] = "Amps"
    record = taken(written(tmp_path / "a.json", answer))
    assert len(record.time) > TICKS / 2


def test_missing_and_invalid_samples_are_never_filled_in(tmp_path, shift):
    lose = {(5, 20)}  # one BPM was not archived at tick 20
    invalid = {(7, 40): 3, (8, 45): 2}  # INVALID is not used, a MAJOR alarm is
    path = written(tmp_path / "a.json", archived(shift, lose, invalid))
    record = taken(path)
    assert record.starts.sum() == 1
    assert set(zip(*np.nonzero(record.filled), strict=True)) == {(20, 5), (40, 7)}
    with h5py.File("history.h5") as file:
        orbit, after = file["orbit"][:], file["next_orbit"][:]
    missing = np.zeros_like(orbit, dtype=bool)
    missing[20, 5] = missing[40, 7] = True
    np.testing.assert_array_equal(np.isnan(orbit), missing)
    np.testing.assert_allclose(orbit[~missing], shift[1][:-1][~missing], atol=1e-12)
    np.testing.assert_allclose(after[-1], shift[1][-1], atol=1e-12)


def test_a_tick_that_most_bpms_miss_is_a_gap(tmp_path, shift):
    record = taken(written(tmp_path / "a.json", archived(shift, {(j, 20) for j in range(100)})))
    assert record.starts.sum() == 2
    assert not record.filled.any()


def test_a_bpm_that_is_mostly_away_is_left_out_by_name(tmp_path, shift, capsys):
    lose = {(5, k) for k in range(10)}
    taken(written(tmp_path / "a.json", archived(shift, lose)))
    assert f"{CHANNELS.bpms[5]}:x" in capsys.readouterr().out
    assert load(tmp_path / "history.h5").record.readings.shape[1] == 179


def test_a_setpoint_does_not_stand_over_a_lost_connection(tmp_path, shift):
    answer = archived(shift)
    corrector = answer[180 + 4]
    # The archiver lost it after tick 29 and had it again from tick 40 on.
    del corrector["data"][30:40]
    corrector["data"][30]["fields"] = {"cnxlostepsecs": str(int(BEGIN) + 3)}
    taken(written(tmp_path / "a.json", answer))
    with h5py.File("history.h5") as file:
        ticks = np.round((file["t"][:] - BEGIN) / PERIOD).astype(int)
    assert sorted(set(range(TICKS - 1)) - set(ticks)) == [*range(29, 40)]


def test_hold_bounds_how_long_a_setpoint_stands(tmp_path, shift):
    answer = archived(shift)
    del answer[180 + 4]["data"][30:40]
    taken(written(tmp_path / "a.json", answer), "--hold", 0.3)
    with h5py.File("history.h5") as file:
        ticks = np.round((file["t"][:] - BEGIN) / PERIOD).astype(int)
    gone = sorted(set(range(TICKS - 1)) - set(ticks))
    assert gone == [*range(31, 40)]


def test_the_unit_is_the_archivers_and_must_not_be_contradicted(tmp_path, shift):
    said = refused(written(tmp_path / "a.json", archived(shift)), "--orbit-unit", "um")
    assert "the file says 'mm'" in said
    assert "is not guessed" in refused(written(tmp_path / "a.json", archived(shift, egu="")))
    said = refused(written(tmp_path / "a.json", archived(shift, egu="um")))
    assert "1000 times smaller" in said and "--anyway" in said


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("{", "no JSON"),
        ("{}", "a list"),
        ("[]", "empty list"),
        ("[{}]", "no meta"),
        ('[{"meta": {"name": "Q"}, "data": []}]', "not of the configured ring"),
        ('[{"meta": {"name": "BPM"}, "data": [{"secs": 1, "val": [1, 2]}]}]', "scalar"),
        ('[{"meta": {"name": "BPM"}, "data": [{"secs": -1, "val": 1}]}]', "out of range"),
        ('[{"meta": {"name": "BPM"}, "data": [{"val": 1}]}]', "secs"),
        ("[" * 100_000, "no JSON"),
    ],
)
def test_what_is_no_answer_of_an_archiver(tmp_path, content, words):
    (tmp_path / "a.json").write_text(content.replace("BPM", CHANNELS.orbit_pvs[0]))
    assert words in refused(tmp_path / "a.json")


def test_a_tolerance_must_not_join_ticks(tmp_path, shift):
    path = written(tmp_path / "a.json", archived(shift))
    assert "could be taken for one" in refused(path, "--tolerance", 0.06)
    assert "larger --tolerance" in refused(path, "--tolerance", 1e-6)


def matlab(path, shift, **more):
    setpoints, orbits = shift
    content = {
        "when": 719_529 + (BEGIN + PERIOD * np.arange(TICKS)[:, None]) / 86_400,
        "x": 1e6 * orbits,
        "amps": setpoints,
        "bpm": np.array(CHANNELS.bpms, dtype=object),
        "cor": np.array(CHANNELS.correctors, dtype=object),
    }
    scipy.io.savemat(path, {"shift": content | more})


MATLAB = ("--time", "shift.when", "--orbit", "shift.x", "--setpoints", "shift.amps",
          "--bpm-names", "shift.bpm", "--corrector-names", "shift.cor")  # fmt: skip
UNITS = ("--time-unit", "datenum", "--orbit-unit", "um", "--setpoint-unit", "A")


def test_matlab_with_datenum(tmp_path, shift):
    matlab(tmp_path / "s.mat", shift)
    record = taken("s.mat", *MATLAB, *UNITS)
    np.testing.assert_allclose(record.readings[: TICKS - 1], shift[1][:-1], atol=1e-12)
    with h5py.File("history.h5") as file:
        assert file["t"][0] == pytest.approx(BEGIN, abs=1e-4)


def test_what_nobody_says_is_asked_for(tmp_path, shift):
    matlab(tmp_path / "s.mat", shift)
    assert "--time-unit" in refused("s.mat", *MATLAB)
    assert "the order is not guessed" in refused("s.mat", *MATLAB[:6], *UNITS)
    assert "--orbit must say" in refused("s.mat", *MATLAB[:2], *UNITS)
    matlab(tmp_path / "t.mat", shift, x=1e6 * shift[1].T)
    assert "transposed" in refused("t.mat", *MATLAB, *UNITS)


def test_a_table_of_named_columns(tmp_path, shift):
    setpoints, orbits = shift
    head = ",".join(["time", *CHANNELS.orbit_pvs, *CHANNELS.correctors])
    rows = np.column_stack([BEGIN + PERIOD * np.arange(TICKS), 1e3 * orbits, 1e3 * setpoints])
    np.savetxt(tmp_path / "s.csv", rows, delimiter=",", header=head, comments="", fmt="%.12g")
    units = ("--time-unit", "s", "--orbit-unit", "mm", "--setpoint-unit", "mA")
    record = taken("s.csv", *units)
    np.testing.assert_allclose(record.readings[: TICKS - 1], orbits[:-1], atol=1e-9)
    np.testing.assert_allclose(record.setpoints[: TICKS - 1], setpoints[:-1], atol=1e-9)
    assert "correct --orbit-unit" in refused("s.csv", *units[:5], "A", "-o", "other.h5")


def table(shift, times, comment="", ends="", names=None, hole=None):
    """A history as a program of text writes it: BPMs in mm, setpoints in A."""
    setpoints, orbits = shift
    numbers = np.column_stack([1e3 * orbits, setpoints])
    names = names or [*CHANNELS.bpms, *CHANNELS.correctors]
    lines = [",".join(["Time", *names]) + ends]
    for k, time in enumerate(times):
        cells = [time, *(f"{value:.12g}" for value in numbers[k])]
        if k == hole:
            cells[6] = "#N/A"
        lines.append(",".join(cells) + ends)
    return comment + "\n".join(lines) + "\n"


def text_times(form, first=BEGIN):
    moments = [datetime.fromtimestamp(first + PERIOD * k, UTC) for k in range(TICKS)]
    return [moment.strftime(form)[:-3] for moment in moments]


IN_MM = ("--orbit-unit", "mm", "--setpoint-unit", "A")


@pytest.mark.parametrize(
    ("how", "options"),
    [
        ({"times": [f"{t}+00:00" for t in text_times("%Y-%m-%dT%H:%M:%S.%f")]}, ()),
        ({"times": text_times("%Y-%m-%d %H:%M:%S.%f")}, ("--time-zone", "UTC")),
        ({"times": text_times("%Y/%m/%d %H:%M:%S.%f"), "comment": "# Data Browser\n# "},
         ("--time-zone", "+00:00")),
        ({"times": [f"{t}Z" for t in text_times("%d-%b-%Y %H:%M:%S.%f")], "ends": ",",
          "comment": "\ufeff% from MATLAB\n"}, ()),
    ],
)  # fmt: skip
def test_times_as_text(tmp_path, shift, how, options):
    (tmp_path / "s.csv").write_text(table(shift, **how))
    record = taken("s.csv", *IN_MM, *options)
    np.testing.assert_allclose(record.readings[: TICKS - 1], shift[1][:-1], atol=1e-9)
    assert record.layout.period == pytest.approx(PERIOD, abs=1e-6)
    with h5py.File("history.h5") as file:
        assert file["t"][0] == pytest.approx(BEGIN, abs=1e-3)


def test_times_without_a_zone_want_one(tmp_path, shift):
    (tmp_path / "s.csv").write_text(table(shift, text_times("%Y-%m-%d %H:%M:%S.%f")))
    assert "give --time-zone UTC" in refused("s.csv", *IN_MM)
    assert "leave --time-unit out" in refused("s.csv", *IN_MM, "--time-unit", "s")


def test_units_in_the_heads_of_columns(tmp_path, shift):
    names = [f"{name} [mm]" for name in CHANNELS.bpms] + [
        f"{name} [Amps]" for name in CHANNELS.correctors
    ]
    times = [f"{t}Z" for t in text_times("%Y-%m-%dT%H:%M:%S.%f")]
    (tmp_path / "s.csv").write_text(table(shift, times, names=names))
    record = taken("s.csv")
    np.testing.assert_allclose(record.readings[: TICKS - 1], shift[1][:-1], atol=1e-9)
    assert "the file says 'mm', --orbit-unit says 'um'" in refused("s.csv", "--orbit-unit", "um")


def test_the_whole_way_to_a_diagnosis_needs_rows(tmp_path, shift):
    answer = archived(shift)
    for entry in answer:
        entry["data"] = entry["data"][:20]
    assert "30 are needed" in refused(written(tmp_path / "a.json", answer))
    assert not (tmp_path / "history.h5").exists()
