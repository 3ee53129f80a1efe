"""As much of libca as a machine needs, without sockets: every PV is a number in a dictionary."""

import ctypes
import threading

import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import Channels
from orbitfb.epics import machine as module
from orbitfb.epics.libca import (
    DBR_CTRL_DOUBLE,
    DBR_DOUBLE,
    ECA_NORMAL,
    OPERATION_UP,
    AccessArguments,
    ConnectionArguments,
    ExceptionArguments,
)
from orbitfb.epics.setpoints.put_errors import OPERATION_PUT
from orbitfb.epics.settings import EpicsSettings

DOWN = OPERATION_UP + 1
PUT_FAILED = 160


class FakeLibrary:
    """The calls; a channel's handle is its place in `names`, from 1 on."""

    def __init__(self) -> None:
        self.names, self.users = [], []
        self.values, self.limits, self.types = {}, {}, {}
        self.puts, self.refuses = [], {}

    def __getitem__(self, name):
        return getattr(self, name)

    def name_of(self, handle):
        return self.names[(handle.value if isinstance(handle, ctypes.c_void_p) else handle) - 1]

    def ca_create_channel(self, name, _handler, user, _priority, handle):
        self.names.append(name.decode())
        self.users.append(user)
        handle._obj.value = len(self.names)
        return ECA_NORMAL

    def ca_puser(self, handle):
        return self.users[handle - 1]

    def ca_write_access(self, _handle):
        return 1

    def ca_field_type(self, handle):
        return self.types.get(self.name_of(handle), DBR_DOUBLE)

    def ca_array_get(self, kind, _count, handle, address):
        name = self.name_of(handle)
        if kind == DBR_CTRL_DOUBLE:
            low, high = self.limits.get(name, (0.0, 0.0))
            ctypes.c_double.from_address(address + 64).value = high
            ctypes.c_double.from_address(address + 72).value = low
        else:
            ctypes.c_double.from_address(address).value = self.values.get(name, 0.0)
        return ECA_NORMAL

    def ca_array_put(self, _kind, _count, handle, address):
        name = self.name_of(handle)
        self.puts.append(name)
        if name in self.refuses:
            self.refuses[name](handle.value)
        else:
            value = ctypes.c_double.from_address(address.value).value
            low, high = self.limits.get(name, (-np.inf, np.inf))
            self.values[name] = float(np.clip(value, low, high))
        return ECA_NORMAL

    def __getattr__(self, name):
        if name.startswith("ca_"):
            return lambda *_: ECA_NORMAL
        raise AttributeError(name)


class FakeContext:
    """Its calls all go well."""

    def __init__(self, _pva=None) -> None:
        self.library, self.listeners = FakeLibrary(), []
        self.telling = None
        self.asking = threading.Lock()

    def attach(self) -> None:
        pass

    def detach(self) -> None:
        pass

    def flush(self) -> None:
        pass

    def destroy(self) -> None:
        pass

    def check(self, _call, status) -> None:
        assert status == ECA_NORMAL

    def subscribe(self, *_arguments) -> None:
        pass

    def message(self, status) -> str:
        return {PUT_FAILED: "Channel write request failed"}.get(status, f"status {status}")

    def host_of(self, _channel) -> str:
        return "127.0.0.1:5064"


class NoKeeper:
    """Looks after nothing."""

    trouble = ""

    def __init__(self, *_arguments) -> None:
        pass

    def start(self) -> None:
        pass

    def stop(self) -> None:
        pass


class Bench:
    """A machine of a few devices whose PVs all answer."""

    def __init__(self, monkeypatch, count=3, names=()) -> None:
        names = names or tuple(f"COR{index}" for index in range(count))
        bpms = tuple(f"BPM{index}" for index in range(count))
        readbacks = tuple(f"{name}:RB" for name in names)
        channels = Channels("x", bpms, names, bpms, names, readbacks)
        monkeypatch.setattr(module, "Context", FakeContext)
        monkeypatch.setattr(module, "Keeper", NoKeeper)
        monkeypatch.setattr(module, "use_network", lambda _settings: None)
        monkeypatch.setattr(module, "wait_for_channels", self._connect)
        self.clock = ManualClock(2.0e9)
        self.machine = module.EpicsMachine(channels, EpicsSettings(), self.clock)
        self.library = self.machine._context.library
        self.setpoints = self.machine._setpoints.group

    @staticmethod
    def _connect(groups, *_rest) -> None:
        for group in groups:
            for index in range(len(group.pvs)):
                group._on_connection(ConnectionArguments(group.handles[index], OPERATION_UP))

    def link(self, index, up) -> None:
        """Let a setpoint go or come."""
        event = OPERATION_UP if up else DOWN
        self.setpoints._on_connection(ConnectionArguments(self.setpoints.handles[index], event))

    def rights(self, index, rights) -> None:
        """Let access rights change."""
        self.setpoints._on_access(AccessArguments(self.setpoints.handles[index], rights))

    def refuse(self, index) -> None:
        """Let the server refuse puts to a setpoint, as DISP does."""
        name = self.setpoints.names[index]
        self.library.refuses[name] = self._refused

    def _refused(self, handle) -> None:
        told = ExceptionArguments(channel=handle, status=PUT_FAILED, operation=OPERATION_PUT)
        for listener in self.machine._context.listeners:
            listener(told)
