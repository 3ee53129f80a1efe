"""The fast front shows exactly what caproto's documented calls show."""

import math

import pytest
from ioc_clients import CHANNELS, READINGS, RawClient, same, serving

pytestmark = pytest.mark.system

SETPOINTS = CHANNELS.setpoint_pvs


def history(plain):
    """Drive a ring by setpoints and give all that a client sees."""
    seen = []
    with (
        serving(plain=plain, lockstep=True, rate_hz=0.02, orbit_warning=2e-4) as child,
        RawClient(child.port) as client,
    ):
        client.create(*READINGS, *SETPOINTS)
        client.subscribe(*READINGS)
        client.events(len(READINGS))
        for round_ in range(4):
            # the third drives some correctors into their alarms
            values = {n: (6.0 * round_ if i % 7 == 0 else 0.1) for i, n in enumerate(SETPOINTS)}
            client.put(values)
            frame = client.frame()
            assert same(frame)
            seen.append([(e.name, e.value, e.status, e.severity) for e in frame])
        for value in (18.0, 17.0, 19.0, math.nan, -17.0, math.inf, 1.0):
            client.put({SETPOINTS[0]: value})
            entry = client.get(SETPOINTS[0])
            seen.append((entry.value, entry.status, entry.severity))
    return seen


def test_values_and_alarms_of_both_are_equal():
    fast, plain = history(plain=False), history(plain=True)
    assert fast == plain
    severities = {entry[3] for frame in fast[:4] for entry in frame}
    assert severities == {0, 1, 2}
