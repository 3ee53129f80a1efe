"""Values, stamps and alarms on the board, against caproto's own judgement."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest
from caproto import AlarmStatus
from hypothesis import given
from hypothesis import strategies as st

from orbitfb.core.names import CURRENT_PV, RF_PV, RF_READBACK_PV
from orbitfb.core.signals import Channels
from orbitfb.sim.access.board import AlarmLimits, Board, Entry
from orbitfb.sim.access.channels import ScalarChannel
from orbitfb.sim.access.stamp import Stamp
from orbitfb.sim.layout import (
    KICK_PV,
    STORED_PV,
    TICK_PV,
    TRUE_RMS_PV,
    PvSpec,
    lay_out,
)
from orbitfb.sim.settings import SimSettings

CHANNELS = Channels(
    planes="x",
    bpms=("B1", "B2", "B3"),
    correctors=("C1", "C2"),
    orbit_pvs=("b{1}", "b{2}", "b{3}"),
    setpoint_pvs=("c{1}:SP", "c{2}:SP"),
    readback_pvs=("c{1}:RB", "c{2}:RB"),
)
LAYOUT = lay_out(CHANNELS, SimSettings(rf_frequency=5e8))
EARLY, LATE = Stamp(1_000_000_000, 1), Stamp(4_294_967_295, 999_999_999)


@pytest.fixture
def board():
    return Board(LAYOUT, EARLY)


def test_the_layout_has_the_order_that_clients_see():
    assert [spec.name for spec in LAYOUT.readings] == [
        *CHANNELS.readback_pvs,
        *CHANNELS.orbit_pvs,
        CURRENT_PV,
        RF_READBACK_PV,
        TRUE_RMS_PV,
        TICK_PV,
    ]
    assert [spec.name for spec in LAYOUT.setpoints] == [*CHANNELS.setpoint_pvs, RF_PV]
    assert LAYOUT.correctors == 2
    assert [spec.name for spec in LAYOUT.knobs] == [KICK_PV, STORED_PV]
    assert len(LAYOUT) == 3 + 2 + 3 + 4 + 2


def test_values_leave_in_the_units_of_the_pvs():
    state = SimpleNamespace(
        reading=np.array([1e-3, -2e-6, 0.0]),
        true_orbit=np.array([3e-3, 4e-3, 0.0]),
        readback=np.array([1.5, -2.5]),
    )
    values = LAYOUT.values(state, 17, stored=300.0)
    rms = 5.0 / np.sqrt(3.0)
    np.testing.assert_allclose(values, [1.5, -2.5, 1.0, -2e-3, 0.0, 300.0, 5e8, rms, 17.0])
    assert LAYOUT.values(state, 17)[5] == 400.0
    assert LAYOUT.values(state, 17, rf=5.001e8)[6] == 5.001e8


def test_all_readings_of_a_tick_carry_its_stamp(board):
    board.show(np.arange(9.0), LATE)
    entries = [board.get(index) for index in range(9)]
    assert {entry.stamp for entry in entries} == {LATE}
    assert [entry.value for entry in entries] == list(range(9))
    assert board.get(9).stamp == EARLY  # setpoints are no readings


def test_setpoints_are_judged_one_by_one(board):
    values = np.array([18.0, -18.0, 18.1, np.nan, np.inf, -np.inf, 0.0])
    which = np.zeros(len(values), dtype=np.intp)
    assert board.allowed(which, values).tolist() == [True, True] + [False] * 4 + [True]
    rf = np.full(4, 2)
    frequencies = np.array([5e8 - 1000.0, 5e8 + 1000.0, 5e8 + 1000.1, 0.0])
    assert board.allowed(rf, frequencies).tolist() == [True, True, False, False]


def test_the_last_of_several_values_for_a_setpoint_stays(board):
    board.write(np.array([1, 0, 1]), np.array([1.0, 2.0, 17.0]), LATE)
    assert board.setpoints.tolist() == [2.0, 17.0, 5e8]
    assert board.written.tolist() == [True, True, False]
    assert board.get(9) == Entry(2.0, LATE, 0, 0)
    assert board.get(10) == Entry(17.0, LATE, AlarmStatus.HIGH, 1)


@given(
    value=st.floats(-1e308, 1e308),
    stamp=st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 999_999_999)),
    status=st.integers(0, 21),
    severity=st.integers(0, 3),
)
def test_an_entry_comes_back_as_it_was(value, stamp, status, severity):
    board = Board(LAYOUT, EARLY)
    entry = Entry(value, Stamp(*stamp), status, severity)
    board.set(4, entry)
    assert board.get(4) == entry
    assert board.get(3).stamp == EARLY


LIMITS = (
    PvSpec("both", "mm", 3, warning=(-1.0, 1.0), alarm=(-3.0, 3.0)),
    PvSpec("none", "mm", 3),
    PvSpec("one-sided", "mm", 3, warning=(0.5, 2.0)),
    PvSpec("alarm alone", "mm", 3, alarm=(-3.0, 3.0)),
)


@given(st.sampled_from([-4.0, -3.0, -2.0, -1.0, 0.0, 0.5, 0.75, 1.0, 2.0, 2.5, 3.0, 4.0, np.inf]))
def test_alarms_are_those_of_caproto(value):
    words = AlarmLimits(LIMITS).judge(np.full(len(LIMITS), value))

    async def judged(spec):
        channel = ScalarChannel(spec)
        await channel.write(value)
        return int(channel.alarm.status), int(channel.alarm.severity)

    for spec, word in zip(LIMITS, words.tolist(), strict=True):
        expected = asyncio.run(judged(spec)) if np.isfinite(value) else (AlarmStatus.UDF, 3)
        assert (word >> 16, word & 0xFFFF) == expected, spec.name


def test_nan_is_invalid():
    assert AlarmLimits(LIMITS).judge(np.full(4, np.nan)).tolist() == [17 << 16 | 3] * 4
