"""Every kind of record becomes the same thing."""

import json
from collections import deque

import h5py
import numpy as np
import pytest

from benchmarks.save import save_npz
from orbitfb.core.clock import ManualClock
from orbitfb.core.errors import RecordError
from orbitfb.core.signals import LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.diagnose.result.naming import as_in_record
from orbitfb.diagnose.result.parts import Cause
from orbitfb.history.archive import ArchiveSettings
from orbitfb.history.recorder import Recorder
from orbitfb.records.reading.load import load, load_record
from orbitfb.records.reading.stretches import time_jumps
from tests.unit.records.record_files import arrays, record, ring, save, small


def check_same(read, made):
    np.testing.assert_allclose(read.readings, made.readings, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(read.setpoints, made.setpoints, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(read.requested, made.requested, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(read.layout.response, made.layout.response, rtol=1e-9)
    np.testing.assert_allclose(read.time, made.time, atol=1e-6)
    np.testing.assert_array_equal(read.starts, made.starts)
    assert read.layout.bpms == made.layout.bpms
    assert read.layout.correctors == made.layout.correctors
    assert read.layout.period == pytest.approx(made.layout.period)
    assert read.layout.ring is not None


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_what_is_saved_reads_back(tmp_path, planes):
    made = record(planes, dither=1e-4, readback=True)
    save_npz(made, tmp_path / "record.npz")
    loaded = load(tmp_path / "record.npz")
    check_same(loaded.record, made)
    np.testing.assert_allclose(loaded.record.readback, made.readback, atol=1e-3)
    np.testing.assert_allclose(loaded.record.dither[:-1], made.dither[:-1])
    np.testing.assert_allclose(loaded.record.reference, made.reference, atol=1e-12)
    assert loaded.findings == ()
    assert len(loaded.record.digest) == 64


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_the_plane_is_told_by_names_or_by_the_model(tmp_path, planes):
    loaded = load(save(tmp_path / "record.npz", arrays(planes)))
    check_same(loaded.record, record(planes))
    told = [finding for finding in loaded.findings if finding.check == "plane"]
    assert len(told) == (0 if planes == "xy" else 1)


def test_hdf5_holds_the_same(tmp_path):
    made = arrays()
    with h5py.File(tmp_path / "record.h5", "w") as file:
        for name, array in made.items():
            if name.endswith("names"):
                file[name] = [str(text) for text in array]  # variable length
            else:
                file.create_dataset(name, data=array, compression="gzip", shuffle=True)
        file["meta"] = json.dumps({"dt_s": 0.1})
    save(tmp_path / "record.npz", made)
    loaded = load_record(tmp_path / "record.h5")
    check_same(loaded, record())
    assert loaded.digest == load_record(tmp_path / "record.npz").digest


def test_few_devices_in_no_order(tmp_path):
    made = small()
    read = load_record(save(tmp_path / "record.npz", made))
    assert read.layout.ring is not None
    assert read.readings.shape == (121, 12)
    assert read.setpoints.shape == (121, 10)
    assert read.layout.bpms.names == tuple(made["bpm_names"])
    assert read.layout.bpms.cells[0] == made["bpm_names"][0][-3:]


def test_one_plane_of_two(tmp_path):
    path = save(tmp_path / "record.npz", small("xy"))
    read = load_record(path, planes="y")
    assert read.layout.planes == ("y",)
    assert read.readings.shape == (121, 12)
    both = load_record(path)
    np.testing.assert_array_equal(both.readings[:, 12:], read.readings)


@pytest.mark.parametrize("letters", [":X :Y", "_x _y", ".H .V"])
def test_suffixes_tell_the_plane(tmp_path, letters):
    made = small("xy")
    x, y = letters.split()
    for name, half in (("bpm_names", 12), ("corr_names", 10)):
        plain = made[name][:half]
        # y first, so that only the suffix can tell.
        made[name] = np.array([f"{each}{y}" for each in plain] + [f"{each}{x}" for each in plain])
    made["orbit"] = np.roll(made["orbit"], 12, axis=1)
    made["next_orbit"] = np.roll(made["next_orbit"], 12, axis=1)
    made["action"] = np.roll(made["action"], 10, axis=1)
    made["setpoint"] = np.roll(made["setpoint"], 10, axis=1)
    made["model_R"] = np.roll(made["model_R"], (12, 10), axis=(0, 1))
    del made["reference"]
    layout = load_record(save(tmp_path / "record.npz", made)).layout
    assert layout.bpms.planes == ("y",) * 12 + ("x",) * 12
    assert layout.correctors.planes == ("y",) * 10 + ("x",) * 10
    assert layout.ring is not None


def test_more_bpms_in_x_than_in_y(tmp_path):
    made = small("xy")
    order = np.argsort([ring().table.name.index(name) for name in made["bpm_names"][:12]])
    keep = np.concatenate([order[1:], 12 + order[:-3]])  # y begins with a BPM that x lacks
    for name in ("orbit", "next_orbit", "reference"):
        made[name] = made[name][:, keep]
    made["model_R"], made["bpm_names"] = made["model_R"][keep], made["bpm_names"][keep]
    layout = load_record(save(tmp_path / "record.npz", made)).layout
    assert layout.bpms.planes == ("x",) * 11 + ("y",) * 9


@pytest.mark.parametrize("planes", ["x", "y", "xy"])
def test_pvs_of_the_ring_are_its_devices(tmp_path, planes):
    made = small(planes)
    names = made["bpm_names"], made["corr_names"]
    pvs = []
    for each, kind in zip(names, ("BPM", "COR"), strict=True):
        behind = {device: pv for pv, device in ring().devices_of_pvs(kind).items()}
        half = len(each) // len(planes)
        pvs.append([behind[str(name), planes[i // half]] for i, name in enumerate(each)])
    made["bpm_names"], made["corr_names"] = map(np.array, pvs)
    loaded = load(save(tmp_path / "record.npz", made))
    layout = loaded.record.layout
    assert layout.ring is not None and "".join(layout.planes) == planes
    assert layout.bpms.names == tuple(names[0]) and layout.correctors.names == tuple(names[1])
    assert layout.bpms.channels == tuple(pvs[0]) and layout.correctors.channels == tuple(pvs[1])
    where = {"places": (names[0][3],), "planes": planes[0]}
    cause = Cause(effect="bpm-gain", stage="sensor", probability=0.9, **where)
    assert as_in_record([cause], layout)[0].places == (pvs[0][3],)
    elsewhere = cause.model_copy(update={"effect": "local-kick"})
    assert as_in_record([elsewhere], layout) == (elsewhere,)


def test_a_pv_that_is_none_is_named(tmp_path):
    made = small()
    behind = {
        name: pv for pv, (name, plane) in ring().devices_of_pvs("BPM").items() if plane == "x"
    }
    pvs = [behind[str(name)] for name in made["bpm_names"]]
    made["bpm_names"] = np.array([pvs[0], f"{pvs[1]}x", *pvs[2:]])
    with pytest.raises(
        RecordError, match=r"array 'bpm_names' has .* in row 1, which is no PV of a"
    ):
        load(save(tmp_path / "record.npz", made))


def test_names_of_nowhere_are_gone_on_with(tmp_path):
    made = small()
    made["bpm_names"] = np.array([f"B{i}" for i in range(12)])
    made["corr_names"] = np.array([f"K{i}" for i in range(10)])
    loaded = load(save(tmp_path / "record.npz", made))
    assert loaded.record.layout.ring is None
    assert ("unknown-ring", "warning") in {(one.check, one.severity) for one in loaded.findings}


def test_names_in_the_place_of_the_others(tmp_path):
    made = small(correctors=12)
    made["bpm_names"], made["corr_names"] = made["corr_names"], made["bpm_names"]
    with pytest.raises(RecordError, match="only devices of the other kind; exchange bpm_names"):
        load(save(tmp_path / "record.npz", made))


def test_a_gap_breaks_the_record(tmp_path):
    made = arrays()
    keep = np.delete(np.arange(120), np.s_[40:45])
    made = {name: a[keep] if len(a) == 120 else a for name, a in made.items()}
    loaded = load(save(tmp_path / "record.npz", made))
    assert loaded.record.stretches == [slice(0, 41), slice(41, 117)]
    np.testing.assert_allclose(loaded.record.readings[40], record().readings[40], rtol=1e-9)
    np.testing.assert_allclose(loaded.record.setpoints[40], record().setpoints[40], rtol=1e-9)
    assert np.isnan(loaded.record.requested[40]).all()
    assert [finding.check for finding in loaded.findings if finding.rows] == ["time-gap"]


def test_a_row_out_of_sequence_breaks_the_record(tmp_path):
    made = arrays()
    made["next_orbit"][70] += 1.0
    loaded = load(save(tmp_path / "record.npz", made))
    assert [s.start for s in loaded.record.stretches] == [0, 72]
    (found,) = [finding for finding in loaded.findings if finding.rows]
    assert found.check == "sequence-gap"
    assert "row 70" in found.text


def test_a_trembling_clock_is_no_gap():
    rng = np.random.default_rng(1)
    time = 0.1 * np.arange(2000) + 0.03 * rng.uniform(-1, 1, 2000)
    assert not time_jumps(time, 0.1).any()
    time[1000:] += 0.1
    np.testing.assert_array_equal(np.flatnonzero(time_jumps(time, 0.1)), [999])


def test_setpoints_are_added_up_when_they_are_missing(tmp_path):
    made = arrays()
    del made["setpoint"]
    loaded = load(save(tmp_path / "record.npz", made))
    given = record().setpoints
    np.testing.assert_allclose(loaded.record.setpoints, given - given[0], atol=1e-9)
    assert any("'setpoint' is missing" in finding.text for finding in loaded.findings)


def test_meta_gives_units_and_the_period(tmp_path):
    made = arrays()
    for name in ("orbit", "next_orbit", "reference"):
        made[name] = made[name] * 1e3
    made["setpoint"], made["action"] = made["setpoint"] * 1e3, made["action"] * 1e3
    made["current"] = np.full(120, 400.0)
    made["temperature"] = np.arange(120.0)
    made["meta"] = np.array(json.dumps({"dt_s": 0.1, "units": {"orbit": "um", "action": "mA"}}))
    read = load_record(save(tmp_path / "record.npz", made))
    check_same(read, record())
    assert read.auxiliary["current"][0] == pytest.approx(0.4)
    assert set(read.auxiliary) == {"current", "temperature"}


def archive_of(directory, made, spoil=()):
    """Write a record as the service would."""
    channels = ring().channels("x")
    recorder = Recorder(directory, channels, ArchiveSettings(), ManualClock())
    queue = deque()
    for tick in range(len(made)):
        position = made.readings[tick].copy()
        valid = np.ones(len(position), dtype=bool)
        for column, ticks in spoil:
            if tick in ticks:
                position[column], valid[column] = np.nan, False
        time = 1.7e9 + 0.1 * tick
        asked = np.nan_to_num(made.requested[tick])
        queue.append(
            TickRecord(
                tick=tick,
                state=LoopState.CLOSED,
                reason="",
                reading=Reading(
                    Orbit(position, valid, time), made.setpoints[tick], {"current": 0.4}, time
                ),
                reference=made.reference[tick],
                setpoints=made.setpoints[tick],
                requested=asked,
                dither=np.zeros_like(asked),
                applied=asked,
                scale=1.0,
                written=time + 0.01,
                policy_id="svd",
                phases=Phases(0, 0, 0, 0, 0),
                latency=0.001,
                missed=0,
            )
        )
    while recorder.write(queue):
        pass
    recorder.close()
    return directory


def test_the_archive_of_the_service(tmp_path):
    made = record()
    loaded = load(archive_of(tmp_path / "archive", made))
    check_same(loaded.record, made)
    assert loaded.findings == ()
    (segment,) = (tmp_path / "archive").glob("*.h5")
    check_same(load_record(segment), made)


def test_invalid_readings_are_filled_in_and_bad_bpms_left_out(tmp_path):
    made = record()
    path = archive_of(tmp_path / "archive", made, [(3, range(50, 53)), (7, range(0, 60))])
    loaded = load(path)
    read = loaded.record
    assert read.layout.bpms.names == tuple(np.delete(ring().names("BPM"), 7))
    assert read.layout.response.shape == (179, 180)
    assert read.filled.sum() == 3
    expected = (
        made.readings[49, 3]
        + made.layout.response[3] @ (made.setpoints[50:53] - made.setpoints[49]).T
    )
    np.testing.assert_allclose(read.readings[50:53, 3], expected, rtol=1e-9)
    dropped, filled = loaded.findings
    assert dropped.check == "bpm-dropped"
    assert dropped.devices == (f"{ring().names('BPM')[7]} (x)",)
    assert filled.check == "invalid-readings"


def test_a_single_row_that_is_missing_does_not_break_the_record(tmp_path):
    """The rows beside it have its orbit, and what the correctors did."""
    made = arrays()
    keep = np.delete(np.arange(120), [40, 80])
    made = {name: a[keep] if len(a) == 120 else a for name, a in made.items()}
    loaded = load(save(tmp_path / "record.npz", made))
    assert loaded.record.stretches == [slice(0, 121)]
    np.testing.assert_allclose(loaded.record.readings, record().readings[:121], rtol=1e-9)
    np.testing.assert_allclose(loaded.record.setpoints, record().setpoints[:121], rtol=1e-9)
    assert np.isnan(loaded.record.requested[[40, 80]]).all()
    (found,) = [finding for finding in loaded.findings if finding.rows]
    assert (found.check, found.severity) == ("missing-row", "note")
    assert "at 2 places, first after row 39" in found.text
