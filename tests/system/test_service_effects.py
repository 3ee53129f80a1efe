"""Effects of the simulated ring and a planned excitation, in a real run."""

import numpy as np
import pytest
from service_process import orbitfb, read_log, refused, transitions

pytestmark = pytest.mark.system

EXCITATION = """
start = 1.0
[[part]]
kind = "ladder"
correctors = ["CL1A_C01"]
amplitude = 0.02
levels = [1, -1, 2, -2]
hold = 3
duration = 1.2
"""
RUN = ("run", "--ioc", "sim", "--port", 0, "--metrics-port", 0, "--rate", 10)


def test_effects_act_and_the_excitation_is_done_once_and_logged(tmp_path):
    plan, data = tmp_path / "excite.toml", tmp_path / "data"
    plan.write_text(EXCITATION, encoding="utf-8")
    effect = "corrector-gain:gain=10%,cells=3-5,from=500ms"
    quiet = {"ORBITFB_INTERLOCKS__ANSWER_REACH": "off"}  # nothing but the plan moves setpoints
    done = orbitfb(
        *RUN, "--duration", 5, "--data", data, "--effect", effect, "--excite", plan, **quiet
    )
    assert done.returncode == 0, done.stderr
    made = transitions(data)
    ring = np.flatnonzero(np.nanmax(np.abs(made.readback - made.setpoints), axis=0) > 1e-9)
    assert len(ring) == 18
    moved = np.flatnonzero(made.dither.any(axis=0))
    assert len(moved) == 1
    stands = np.cumsum(made.dither[:, moved[0]])
    begin = int(np.flatnonzero(stands)[0])
    levels = 0.02 * np.repeat([1.0, -1.0, 2.0, -2.0], 3)
    np.testing.assert_allclose(stands[begin : begin + 12], levels, atol=1e-12)
    np.testing.assert_allclose(stands[begin + 12 :], 0.0, atol=1e-12)
    (end,) = [line for line in read_log(data) if line["event"] == "excitation"]
    assert (end["progress"], end["ticks"]) == ("done", 12)


def test_what_cannot_be_done_is_refused_before_anything_starts(tmp_path):
    plan, data = tmp_path / "excite.toml", tmp_path / "data"
    plan.write_text(EXCITATION.replace("0.02", "1.2"), encoding="utf-8")
    said = refused(*RUN, "--duration", 6, "--data", data, "--excite", plan)
    assert "CL1A_C01 by 4.8 A in one tick; allowed are 2 A" in said
    plan.write_text(EXCITATION, encoding="utf-8")
    said = refused(*RUN, "--duration", 2, "--data", data, "--excite", plan)
    assert "needs 2.3 s of a closed loop" in said
    said = refused(*RUN, "--data", data, "--effect", "corrector-gain:gain=10%,cells=33")
    assert "'33' is no cell with correctors" in said
    said = refused("run", "--ioc", "127.0.0.1", "--data", data, "--effect", "bpm-gain")
    assert "--effect and --effects are of a simulated ring" in said
