"""Channels over pvAccess on a client without sockets: who is told what, what becomes of puts."""

from importlib.util import find_spec
from queue import SimpleQueue
from threading import Lock

import numpy as np
import pytest
from lazily import Lazy

from orbitfb.core.errors import WriteError
from orbitfb.core.names import named_pvs
from orbitfb.epics.pva.channels import PvaChannels

raw = Lazy("p4p.client.raw")
pytestmark = pytest.mark.skipif(find_spec("p4p") is None, reason="the extra `pva` is not installed")


class Told(dict):
    """As much of a value of p4p as is looked at."""

    def has(self, name):
        return name in self

    def changed(self, *names):
        return any(key.partition(".")[0] in names for key in self)


class Monitor:
    def __init__(self, wake):
        self.events, self.wake, self.closed = SimpleQueue(), wake, False

    def pop(self):
        return None if self.events.empty() else self.events.get()

    def tell(self, event):
        self.events.put(event)
        self.wake()

    def close(self):
        self.closed = True


class Operation:
    def __init__(self, handler, builder=None):
        self.handler, self.builder, self.closed = handler, builder, False
        self.structure = {}
        if builder is not None:
            self.build()

    def build(self):
        """As p4p does once the server has said what the PV is, also after it came back."""
        try:
            self.builder(self.structure)
        except Exception as error:
            self.handler(error)

    def close(self):
        self.closed = True


class Client:
    """What p4p does, as far as it is asked."""

    def __init__(self):
        self.monitors, self.puts, self.gets, self.dropped = {}, [], [], []
        self.answers = {}

    def monitor(self, name, wake):
        self.monitors[name] = Monitor(wake)
        return self.monitors[name]

    def put(self, name, handler, builder, request, get):
        assert not get
        self.puts.append(Operation(handler, builder))
        return self.puts[-1]

    def get(self, name, handler):
        self.gets.append(Operation(handler))
        if name in self.answers:
            handler(self.answers[name])
        return self.gets[-1]

    def disconnect(self, name):
        self.dropped.append(name)


class Listener:
    def __init__(self):
        self.heard = []

    def pva_came(self, number):
        self.heard.append(("came", number))

    def pva_gone(self, number):
        self.heard.append(("gone", number))

    def pva_told(self, number, held, changed):
        self.heard.append(("told", number, held.values.tolist(), changed))

    def pva_refused(self, number, words):
        self.heard.append(("refused", number, words))


def value(*values, **more):
    return Told(value=np.array(values), **more)


class Bench:
    def __init__(self):
        self.client, self.listener = Client(), Listener()
        pvs = dict(enumerate(named_pvs(("pva://A.[0]", "pva://A.[1]", "pva://B"))))
        self.its = PvaChannels(self.client, Lock(), pvs, self.listener)
        self.its.open()

    def tell(self, name, event):
        self.client.monitors[name].tell(event)

    def heard(self):
        heard, self.listener.heard = self.listener.heard, []
        return heard


@pytest.fixture
def bench():
    return Bench()


def test_it_comes_with_its_first_value_and_goes_when_it_is_told(bench):
    bench.tell("A", value(1.0, 2.0))
    assert bench.heard() == [("came", 0), ("told", 0, [1.0, 2.0], False)]
    bench.tell("A", value(3.0, 4.0, **{"display.units": "mm"}))
    assert bench.heard() == [("told", 0, [3.0, 4.0], True)]
    for _ in range(2):
        bench.tell("A", raw.Disconnected())
    assert bench.heard() == [("gone", 0)]
    assert not bench.its.present


def test_what_is_away_is_searched_for_anew_and_the_rest_left_alone(bench):
    bench.tell("A", value(1.0, 2.0))
    old = bench.client.monitors["B"]
    bench.its.search()
    assert bench.client.dropped == ["B"] and old.closed
    bench.heard()
    bench.tell("B", value(5.0))
    assert bench.heard() == [("came", 1), ("told", 1, [5.0], False)]


def test_an_array_is_put_as_one_and_a_scalar_as_a_number(bench):
    bench.tell("A", value(1.0, 2.0))
    bench.tell("B", value(5.0))
    sent = np.array([7.0, 8.0])
    bench.its.put(0, sent)
    sent[:] = 0.0
    bench.its.put(1, np.array([9.0]))
    first, second = (put.structure["value"] for put in bench.client.puts)
    assert first.tolist() == [7.0, 8.0] and second == 9.0 and isinstance(second, float)


def test_a_refusal_is_told_and_an_answer_or_a_cancelled_put_is_not(bench):
    bench.tell("A", value(1.0, 2.0))
    for _ in range(3):
        bench.its.put(0, np.zeros(2))
    bench.heard()
    done, cancelled, refused = bench.client.puts
    done.handler(None)
    cancelled.handler(raw.Cancelled())
    refused.handler(raw.RemoteError("not for you"))
    assert bench.heard() == [("refused", 0, "not for you")]


def test_a_put_that_is_under_way_is_not_sent_to_the_server_that_comes_back(bench):
    """That may be minutes later."""
    bench.tell("A", value(1.0, 2.0))
    bench.tell("B", value(5.0))
    bench.its.put(0, np.zeros(2))
    bench.its.put(1, np.zeros(1))
    bench.tell("A", raw.Disconnected())
    first, second = bench.client.puts
    assert not first.closed  # p4p takes the connection down just now
    with pytest.raises(WriteError, match="A goes away while it is put"):
        bench.its.put(0, np.zeros(2))  # it was connected when the caller looked
    assert first.closed and not second.closed
    bench.tell("A", value(1.0, 2.0))
    bench.heard()
    for put in bench.client.puts:
        put.structure = {}
        put.build()
    assert [bool(put.structure) for put in bench.client.puts] == [False, True, False]
    assert bench.heard() == []


def test_those_that_do_not_answer_are_left_out(bench):
    bench.client.answers = {
        "A": value(1.0, 2.0, **{"control.limitLow": -1, "control.limitHigh": 1})
    }
    found = bench.its.ask((0, 1), 0.01)
    assert list(found) == [0] and found[0].limits == (-1.0, 1.0)
    bench.client.answers["B"] = raw.RemoteError("no")
    assert list(bench.its.ask((0, 1), 1.0)) == [0]
    assert all(get.closed for get in bench.client.gets)


def test_after_the_end_nothing_is_listened_to(bench):
    bench.tell("A", value(1.0, 2.0))
    bench.its.put(0, np.zeros(2))
    bench.its.close()
    assert all(monitor.closed for monitor in bench.client.monitors.values())
    assert bench.client.puts[0].closed
