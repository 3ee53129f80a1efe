"""A simulated ring that answers as a measured response says (`sim.response`)."""

import numpy as np
import pytest

from orbitfb.config.load import load_config
from orbitfb.core.errors import RingError
from orbitfb.measure.column import Table
from orbitfb.measure.judging import Judgement
from orbitfb.measure.response_file import write_response
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.sim.job import SimJob
from orbitfb.sim.settings import SimSettings

RING = Ring.load()


@pytest.fixture
def measured(tmp_path):
    """A response with a weak BPM and a column that was not measured, and its file."""
    table, channels = Table.empty(180, 180), RING.channels("x")
    for array in table.tensors().values():
        array[:] = 0.0
    table.response[:] = response(RING, "x")
    table.response[7] *= 0.5
    table.response[:, 5] = np.nan
    file = tmp_path / "response.safetensors"
    write_response(file, table, np.zeros(180), channels, Judgement({}, {}, ()), {})
    return table.response, file


def test_the_ring_answers_as_measured_and_as_the_optics_say_elsewhere(measured):
    matrix, file = measured
    plant, _ = SimJob(sim=SimSettings(response=file)).build()
    nominal = response(RING, "x")
    wanted = np.where(np.isfinite(matrix), matrix, nominal)
    np.testing.assert_allclose(plant.response, wanted, atol=1e-15)
    assert np.abs(plant.response[7] - nominal[7]).max() > 1e-6
    np.testing.assert_array_equal(plant.nominal_response, nominal)


def test_a_response_of_other_planes_is_refused(measured):
    with pytest.raises(RingError, match="other planes"):
        SimJob(planes="y", sim=SimSettings(response=measured[1])).build()


def test_the_file_is_seen_from_the_configuration(measured, tmp_path):
    (tmp_path / "ring.toml").write_text('[sim]\nresponse = "response.safetensors"\n')
    assert load_config(tmp_path / "ring.toml").sim.response == measured[1]
