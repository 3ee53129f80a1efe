"""The comparison of devices, on the processor alone: what a GPU would be measured with."""

import json

import pytest

from benchmarks.devices import main
from orbitfb.core.errors import ConfigError


@pytest.mark.nightly
def test_a_device_equals_itself(tmp_path, capsys):
    file = tmp_path / "devices.json"
    small = ["--iterations", "3", "--trajectories", "2", "--steps", "100"]
    main(["--devices", "cpu,cpu", *small, "--out", str(file)])
    assert "only the processor was measured" in capsys.readouterr().out
    _, again = json.loads(file.read_text())["devices"]
    assert again["gains apart"] == again["final orbits apart"] == 0.0
    assert again["training step [ms]"] > 0.0


def test_a_device_that_there_is_not_is_refused():
    with pytest.raises(ConfigError, match="tpu"):
        main(["--devices", "tpu"])
