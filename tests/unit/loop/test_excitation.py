import numpy as np
import pytest
from scripted import RESPONSE, ConstantPolicy, M, N, ScriptedMachine, channels, new_clock

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import LoopState
from orbitfb.loop.excitation.design import ExcitationSettings, check_excitation, design
from orbitfb.loop.excitation.dither import Dither, DitherSettings
from orbitfb.loop.excitation.file import HOW_TO, read_excitation
from orbitfb.loop.excitation.movement import Excitation, Progress, Waveform
from orbitfb.loop.runner import Runner
from orbitfb.loop.settings import LoopSettings
from orbitfb.loop.slot import PolicySlot
from orbitfb.safety.interlocks import InterlockSettings
from orbitfb.safety.limits import LimitSettings

CHANNELS = channels()
ROWS = np.random.default_rng(3).standard_normal((5, M)) * 0.1


def advance(excitation, ticks, share=1.0):
    there = []
    for _ in range(ticks):
        excitation.settle(share * excitation.propose())
        there.append(excitation.excursion.copy())
    return np.array(there)


def test_it_waits_does_every_row_once_and_goes_home():
    excitation = Excitation(Waveform(ROWS, wait=2), Dither.off(M))
    there = advance(excitation, 10)
    expected = np.vstack([np.zeros((2, M)), ROWS, np.zeros((3, M))])
    np.testing.assert_allclose(there, expected, atol=1e-15)
    assert excitation.progress is Progress.DONE
    assert excitation.rows == 5
    excitation.restart()
    assert not advance(excitation, 8).any()


def test_a_hold_does_not_end_it_but_a_trip_does():
    held = Excitation(Waveform(ROWS, wait=0), Dither.off(M))
    advance(held, 2)
    held.restart(held=True)
    np.testing.assert_allclose(advance(held, 3), ROWS[2:])
    tripped = Excitation(Waveform(ROWS, wait=1), Dither.off(M))
    tripped.restart()
    assert tripped.progress is Progress.WAITING
    advance(tripped, 3)
    tripped.restart()
    assert tripped.progress is Progress.ABANDONED
    assert not advance(tripped, 8).any()


def test_a_dither_goes_on_below_and_a_shortened_change_is_caught_up():
    below, alone = (
        Dither(DitherSettings(orbit_cost=1e-7, seed=3), RESPONSE, 0.5) for _ in range(2)
    )
    excitation = Excitation(Waveform(ROWS, wait=1), below)
    advance(excitation, 1)
    alone.settle(alone.propose())
    np.testing.assert_allclose(excitation.excursion, alone.excursion)
    advance(excitation, 1, share=0.5)
    half = excitation.propose()
    alone.settle(0.5 * alone.propose())
    alone_next = alone.propose()
    np.testing.assert_allclose(half, alone_next + ROWS[1] - 0.5 * ROWS[0])


def test_the_loop_writes_it_and_logs_it_as_dither():
    clock, records = new_clock(), []
    machine = ScriptedMachine(clock)
    excitation = Excitation(Waveform(ROWS, wait=3), Dither.off(M))
    runner = Runner(
        machine,
        PolicySlot(ConstantPolicy(np.zeros(M))),
        LoopSettings(ramp=0.0),
        LimitSettings(),
        InterlockSettings(),
        np.zeros(N),
        clock,
        excitation,
        LoopState.CLOSED,
        (records.append,),
        random=np.random.default_rng(1),
    )
    for _ in range(14):
        runner.step()
    written = np.array([record.dither for record in records])
    closed = next(i for i, record in enumerate(records) if record.state is LoopState.CLOSED)
    begin = closed + 3
    assert not written[:begin].any()
    np.testing.assert_allclose(np.cumsum(written, axis=0)[begin : begin + 5], ROWS, atol=1e-15)
    np.testing.assert_allclose(np.array(machine.writes)[3:8], ROWS, atol=1e-15)
    np.testing.assert_allclose(machine.writes[-1], 0.0, atol=1e-15)


def test_descriptions(tmp_path):
    path = tmp_path / "excite.toml"
    path.write_text(
        """
start = 2.0
[[part]]
kind = "ladder"
correctors = ["COR1"]
amplitude = 0.1
levels = [1, -1, 2]
hold = 2
duration = 0.6
[[part]]
kind = "prbs"
modes = [1, 3]
amplitude = [0.1, 0.2]
duration = 1.0
""",
        encoding="utf-8",
    )
    made = read_excitation(path, CHANNELS, RESPONSE, 0.1)
    assert made.wait == 20
    assert made.excursion.shape == (16, M)
    np.testing.assert_allclose(made.excursion[:6, 1], [0.1, 0.1, -0.1, -0.1, 0.2, 0.2])
    modes = np.linalg.svd(RESPONSE, full_matrices=False)[2]
    np.testing.assert_allclose(
        np.abs(made.excursion[6:] @ modes.T), np.tile([0.1, 0, 0.2, 0], (10, 1)), atol=1e-15
    )
    np.testing.assert_array_equal(
        made.excursion, read_excitation(path, CHANNELS, RESPONSE, 0.1).excursion
    )


def test_arrays(tmp_path):
    path = tmp_path / "excite.npz"
    np.savez(path, waveform=ROWS[:, :2], corr_names=["COR3", "COR0"], start_s=1.0)
    made = read_excitation(path, CHANNELS, RESPONSE, 0.1)
    assert made.wait == 10
    np.testing.assert_array_equal(made.excursion[:, [3, 0]], ROWS[:, :2])
    assert not made.excursion[:, 1:3].any()


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"waveform": ROWS}, "has no corr_names; .*diagnose plan RECORD --out FILE"),
        ({"waveform": ROWS, "corr_names": ["COR0"]}, r"shape \(5, 4\); it must be \(T, 1\)"),
        ({"waveform": ROWS[:, :1], "corr_names": ["COR9"]}, "no corrector called 'COR9'"),
        ({"waveform": ROWS[:, :2], "corr_names": ["COR0", "COR0"]}, "COR0 is not unique"),
        ({"waveform": ROWS[:, :1] * np.nan, "corr_names": ["COR0"]}, "finite numbers"),
        ({"waveform": np.array([[{}]]), "corr_names": ["COR0"]}, "no file of arrays"),
    ],
)
def test_wrong_arrays(tmp_path, arrays, words):
    path = tmp_path / "excite.npz"
    np.savez(path, **arrays)
    with pytest.raises(ConfigError, match=words):
        read_excitation(path, CHANNELS, RESPONSE, 0.1)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r"part is missing; .*\[\[part\]\] .*diagnose plan RECORD --out FILE"),
        ("x = 1", "x is no key of a description; "),
        ("part = 3", "part: Input should be"),
        ('[[part]]\nkind="prbs"\namplitude=1\nduration=1', "either modes or correctors"),
        ('[[part]]\nkind="prbs"\nmodes=[5]\namplitude=1\nduration=1', "numbered from 1 to 4"),
        ('[[part]]\nkind="prbs"\nmodes=[1]\namplitude=[1,2]\nduration=1', "2 amplitudes for 1"),
        ('[[part]]\nkind="sine"\nmodes=[1]\namplitude=1\nduration=1', "part 1 kind: .*got .sine."),
    ],
)
def test_wrong_descriptions(tmp_path, text, words):
    path = tmp_path / "excite.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=words):
        read_excitation(path, CHANNELS, RESPONSE, 0.1)


def test_a_wrong_part_is_told_once_and_a_file_is_not_printed(tmp_path):
    path = tmp_path / "excite.toml"
    path.write_text(
        '[[part]]\nkind = "prbs"\nmodes = [1]\namplitude = 1\nhold = 0\nduration = nan\n'
    )
    with pytest.raises(ConfigError) as raised:
        read_excitation(path, CHANNELS, RESPONSE, 0.1)
    said = str(raised.value)
    assert "part 1 hold: " in said and "got nan; a description" in said
    assert "at least 1 item" not in said and "{" not in said.removesuffix(HOW_TO)
    path.write_text("")
    with pytest.raises(ConfigError, match=r": part is missing; a desc"):
        read_excitation(path, CHANNELS, RESPONSE, 0.1)


def test_what_is_beyond_a_limit_is_refused():
    everything = np.ones(M, dtype=bool)

    def check(rows, orbit=1e-3, movable=everything):
        waveform = Waveform(rows, 0)
        check_excitation(waveform, CHANNELS, RESPONSE, LimitSettings(), orbit, movable)

    check(ROWS)
    with pytest.raises(ConfigError, match=r"limits.change_per_tick"):
        check(np.full((2, M), 2.1))
    with pytest.raises(ConfigError, match=r"limits.change_per_tick"):
        check(np.array([[1.5] * M, [-1.5] * M]))
    with pytest.raises(ConfigError, match=r"interlocks.distortion_rms"):
        check(ROWS, orbit=1e-7)
    with pytest.raises(ConfigError, match="COR2, which is masked"):
        check(ROWS, movable=np.arange(M) != 2)


def test_a_white_part_has_the_amplitude_that_it_states():
    part = {"kind": "white", "modes": (2,), "amplitude": (0.3,), "duration": 1000.0}
    made = design(ExcitationSettings.model_validate({"part": [part]}), CHANNELS, RESPONSE, 0.1)
    size = np.sqrt(np.mean(np.sum(made.excursion**2, axis=1)))
    assert size == pytest.approx(0.3, rel=0.05)
