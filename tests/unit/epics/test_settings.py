"""Settings, and what they do to the environment."""

import os

import pytest
from pydantic import ValidationError

from orbitfb.epics.settings import EpicsSettings


def test_defaults_stay_on_this_computer():
    settings = EpicsSettings()
    assert settings.address_list == "127.0.0.1"
    assert not settings.auto_address_list


def test_default_slow_channels_are_the_machine_s():
    channels = EpicsSettings().auxiliary
    assert channels["current"].pv == "SR:C03-BI{DCCT:1}I:Real-I"
    assert channels["current"].scale == 1e-3
    assert channels["rf_frequency"].pv == "RF{Osc:1}Freq:SP"
    assert channels["rf_frequency"].scale == 1.0


def test_every_key_is_described():
    for name, field in EpicsSettings.model_fields.items():
        assert field.description, name


@pytest.mark.parametrize(
    "wrong", [{"server_port": 0}, {"stale_after": 0.0}, {"stamp_window": -1.0}, {"adress": "x"}]
)
def test_wrong_settings_are_refused(wrong):
    with pytest.raises(ValidationError):
        EpicsSettings(**wrong)


def test_importing_the_machine_does_not_load_pyepics():
    """libca reads the environment when it starts: not before it has been set."""
    import subprocess
    import sys

    code = "import sys, orbitfb.epics.machine; sys.exit('epics' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], env=os.environ, check=False).returncode == 0
