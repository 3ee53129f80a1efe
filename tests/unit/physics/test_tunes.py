"""A tune that the phases of the table do not lead up to is refused."""

import json
from importlib import resources

import pytest

from orbitfb.core.errors import RingError
from orbitfb.physics.places import Ring

RING = json.loads((resources.files("orbitfb") / "data/ring.json").read_text(encoding="utf-8"))


def load(tmp_path, **changed):
    file = tmp_path / "ring.json"
    file.write_text(json.dumps(RING | changed))
    return Ring.load(None, file)


@pytest.mark.parametrize(
    ("key", "tune"),
    [("nu_x", 32.22), ("nu_x", 34.22), ("nu_x", 3.322), ("nu_y", 15.26), ("nu_y", 17.26)],
)
def test_a_mistyped_tune_is_refused(tmp_path, key, tune):
    with pytest.raises(RingError, match=rf"{key} = {tune} does not fit .*mu_{key[-1]}_2pi ends at"):
        load(tmp_path, **{key: tune})


def test_the_working_point_may_move_a_little(tmp_path):
    assert load(tmp_path, nu_x=33.27, nu_y=16.21).tune("x") == 33.27
