"""The doctor at a simulated ring: it sees every PV, names those that are away, writes none."""

import time

import pytest

from orbitfb.app.doctor.finding import Verdict
from orbitfb.app.doctor.ring import look_at_ring
from orbitfb.config.tree import AppConfig
from orbitfb.physics.places import Ring

pytestmark = pytest.mark.system


def asked(port, deadline):
    found = look_at_ring(AppConfig(), Ring.load(), f"127.0.0.1:{port}", False, deadline)
    return {each.check: each for each in found}


def test_a_ring_that_answers_and_one_that_does_not(ioc, dead_port):
    found = asked(ioc.port, 20.0)
    for check in ("BPMs", "setpoints", "readbacks", "readings", "write access"):
        assert found[check].verdict is Verdict.OK, found[check]
    assert found["BPMs"].told.startswith("180 of 180")
    assert abs(found["readings"].figures["age_s"]) < 1
    began = time.monotonic()
    found = asked(dead_port, 0.5)
    assert time.monotonic() - began < 10
    assert found["setpoints"].verdict is Verdict.FAILED
    assert len(found["setpoints"].figures["away"]) == 180
    assert "readings" not in found
