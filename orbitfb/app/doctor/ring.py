"""The PVs of the ring: does each answer, how fresh, may the setpoints be written. Only read."""

import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

import numpy as np

from orbitfb.app.doctor.finding import Finding, Verdict
from orbitfb.app.doctor.orbits import ENOUGH, Listener, judge
from orbitfb.app.setup.production_guard import check_live, pvs_of
from orbitfb.app.setup.startup import SIMULATED, find_ring, servers_of
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError, MachineError
from orbitfb.core.names import any_over_pva
from orbitfb.core.signals import Vector
from orbitfb.epics.channels import ChannelGroup
from orbitfb.epics.connecting import UnitWatch, steps_of
from orbitfb.epics.events import Monitor
from orbitfb.epics.libca import Context
from orbitfb.epics.network import environment_lock, use_network
from orbitfb.epics.pva.provider import pva_client
from orbitfb.epics.records import stamps_of, usable, wall_time
from orbitfb.epics.requests import Getter
from orbitfb.epics.servers import Doubles, ServerWatch
from orbitfb.epics.settings import EpicsSettings
from orbitfb.loop.machines.stepped import rounding_told
from orbitfb.physics.places import Ring
from orbitfb.physics.response import response
from orbitfb.safety.bounds import narrower

_PART = "ring"
_LOOK_EVERY = 0.02
_SETTLE = 0.5
"""How long values and second answers are waited for once every PV is connected [s]."""

_TICKS = 6
"""Periods of the loop that are listened for, unless enough came before."""

_MOST_NAMED = 5


def look_at_ring(
    config: AppConfig, ring: Ring, ioc: str | None, live: bool, deadline: float
) -> Iterator[Finding]:
    """Search for every PV of the ring, within a time; nothing is ever written.

    Args:
        config: Names the planes and the slow channels.
        ring: The ring.
        ioc: As on the command line; None: no ring is looked at.
        live: Whether a machine may be asked: without it nothing beyond this computer is.
        deadline: How long to wait for all PVs together [s].

    Raises:
        ConfigError: The ring is not to be asked without `--live`, or is no address.
    """
    if ioc is None or ioc == SIMULATED:
        own = "a simulated ring of its own is made by `orbitfb run`" if ioc else "no --ioc given"
        yield Finding(_PART, "PVs", Verdict.SKIPPED, f"{own}; --ioc HOST:PORT looks at one")
        return
    settings = find_ring(config, ioc)
    if settings.auto_address_list:
        settings = settings.model_copy(update={"auto_address_list": False})
        yield Finding(
            _PART,
            "automatic address list",
            Verdict.WARNING,
            "is on; here the named addresses alone are searched",
            "name the addresses of the IOCs, and set epics.auto_address_list = false "
            "(EPICS_CA_AUTO_ADDR_LIST=NO)",
        )
    if not settings.address_list.split() and not settings.name_servers.split():
        yield Finding(_PART, "PVs", Verdict.SKIPPED, "no address is named to search",
                      "set epics.address_list or EPICS_CA_ADDR_LIST")  # fmt: skip
        return
    servers = servers_of(settings)
    check_live(settings, ioc, None, live, pvs_of(config))
    beyond = [server for server in servers if not server.startswith("127.")]
    if beyond and not live:
        raise ConfigError(
            f"--ioc {ioc}: {', '.join(beyond)} is beyond this computer; give --live if you mean to "
            "ask a machine (nothing is written)"
        )
    yield from _search(settings, ring, config, deadline, servers)


def _search(
    settings: EpicsSettings,
    ring: Ring,
    config: AppConfig,
    deadline: float,
    servers: Sequence[str],
) -> Iterator[Finding]:
    channels = ring.channels(config.ring.planes)
    slow = {each.pv: name for name, each in config.epics.auxiliary.items()}
    kinds = {
        "BPMs": channels.orbit_pvs,
        "setpoints": channels.setpoint_pvs,
        "readbacks": tuple(filter(None, channels.readback_pvs)),
        "slow channels": tuple(slow),
    }
    listener, doubles = Listener(len(channels.orbit_pvs), settings), Doubles()
    assembler = listener.assembler
    records = assembler.records
    with environment_lock:
        use_network(settings)
        context = Context(pva_client(settings, chain.from_iterable(kinds.values())))
        context.listeners.append(doubles.hear)
        heard = Monitor(records, listener.arrived, listener.complete)
        groups = {
            kind: ChannelGroup(context, names, heard, assembler.set_connected)
            if kind == "BPMs"
            else ChannelGroup(context, names)
            for kind, names in kinds.items()
        }
        for group in groups.values():
            group.open()
    try:
        began = time.monotonic()
        while time.monotonic() - began < deadline:
            if all(group.all_connected for group in groups.values()):
                break
            time.sleep(_LOOK_EVERY)
        waited = time.monotonic() - began
        bpms = groups["BPMs"]
        settled = time.monotonic() + min(_SETTLE, deadline)
        until = time.monotonic() + min(max(_SETTLE, _TICKS * config.loop.period), deadline)
        while bpms.connected.any() and (now := time.monotonic()) < until:
            if listener.fewest > ENOUGH and now >= settled:
                break
            time.sleep(_LOOK_EVERY)
        where = f"{', '.join(servers)}, {waited:.1f} s"
        found = [_reached(kind, group, where, slow) for kind, group in groups.items()]
        found += _servers(ServerWatch(tuple(groups.values())), doubles)
        if bpms.connected.any():
            found += _units(context, groups, settings, channels.bpm_units)
            found.append(_fresh(records[bpms.connected].copy(), settings))
            found += judge(listener, bpms.names, settings, config.loop)
        found += [
            _writable(groups["setpoints"]),
            _real(groups["setpoints"], response(ring, config.ring.planes), settings),
        ]
        if groups["setpoints"].connected.any():
            found.append(_drive_limits(context, groups["setpoints"], config))
    finally:
        for group in groups.values():
            group.forget()
        context.destroy()
    yield from found


def _servers(watch: ServerWatch, doubles: Doubles) -> Iterator[Finding]:
    """Tell which servers answer, and PVs that several of them have."""
    servers = watch.servers()
    told = ", ".join(f"{count} PVs from {server}" for server, count in servers.items())
    double = doubles.describe()
    if servers:
        yield Finding(
            _PART,
            "servers",
            Verdict.WARNING if double else Verdict.OK,
            f"{told}; {double}" if double else told,
            "stop the server that is not the machine, or leave its address out" if double else "",
            {"servers": servers},
        )


def _units(
    context: Context,
    groups: Mapping[str, ChannelGroup],
    settings: EpicsSettings,
    said: Sequence[str],
) -> Iterator[Finding]:
    """Compare the units that the records state with those of the configuration."""
    kinds = [groups[kind] for kind in ("BPMs", "setpoints", "readbacks")]
    try:
        UnitWatch(context, kinds, settings, said)
    except MachineError as error:
        yield Finding(_PART, "units", Verdict.FAILED, str(error), "the values would be taken for "
                      "others by powers of ten")  # fmt: skip
    else:
        yield Finding(_PART, "units", Verdict.OK, "none of the BPMs and correctors states "
                      "another than the configuration")  # fmt: skip


def _reached(kind: str, group: ChannelGroup, where: str, slow: Mapping[str, str]) -> Finding:
    away, total = group.disconnected, len(group.pvs)
    names = ", ".join(away[:_MOST_NAMED]) + (" …" if len(away) > _MOST_NAMED else "")
    told = f"{total - len(away)} of {total} answer ({where})" + (f"; not {names}" if away else "")
    keys = " and ".join(f"epics.auxiliary.{slow[name]}" for name in away if name in slow)
    return Finding(
        _PART,
        kind,
        Verdict.FAILED if away else Verdict.OK,
        told,
        "is the IOC running there, are the names those of the places table? "
        "A longer --deadline helps where gateways are slow"
        if away and not keys
        else f"is the IOC running there? Let {keys} name a PV that is there, or leave it out"
        if away
        else "",
        {"total": total, "away": list(away)},
    )


def _fresh(records: np.ndarray, settings: EpicsSettings) -> Finding:
    """Judge the stamps of the BPMs against the clock of this computer."""
    good = records[usable(records)]
    if not len(good):
        return Finding(_PART, "readings", Verdict.FAILED, "none is valid",
                       "is there beam, are the BPMs' IOCs up?")  # fmt: skip
    age = time.time() - wall_time(int(stamps_of(good).max()))
    spread = float(np.ptp(stamps_of(good))) / 1e9
    told = f"{len(good)} of {len(records)} valid, newest {age:.2f} s old, {spread:.3g} s apart"
    figures = {"valid": len(good), "age_s": age, "spread_s": spread}
    if -settings.stale_after < age <= settings.stale_after:
        return Finding(_PART, "readings", Verdict.OK, told, figures=figures)
    return Finding(
        _PART,
        "readings",
        Verdict.FAILED,
        told,
        f"orbits older than epics.stale_after = {settings.stale_after:g} s are refused: see the "
        "clocks of both computers, and whether the BPMs update",
        figures,
    )


def _writable(group: ChannelGroup) -> Finding:
    """Tell what servers say of the rights; nothing is tried."""
    read_only = group.read_only
    told = f"{int(group.writable.sum())} of {len(group)} setpoints may be written by this user"
    if any_over_pva(group.names):
        told += "; over pvAccess only a put tells"
    return Finding(
        _PART,
        "write access",
        Verdict.WARNING if read_only else Verdict.OK if group.connected.any() else Verdict.SKIPPED,
        told,
        "ask for write access for this host and user" if read_only else "",
        {"read_only": list(read_only)},
    )


def _real(group: ChannelGroup, matrix: Vector, settings: EpicsSettings) -> Finding:
    """Tell whether the setpoints can hold a current, and what rounding does to the orbit."""
    holds = group.contents
    wrong = tuple(dict.fromkeys((*holds.not_numbers, *holds.odd_arrays, *holds.not_whole)))
    told = rounding_told(steps_of(group, settings), matrix, group.names)
    verdict = Verdict.WARNING if told else Verdict.OK
    return Finding(
        _PART,
        "setpoint records",
        Verdict.FAILED if wrong else verdict if group.connected.any() else Verdict.SKIPPED,
        f"{len(wrong)} cannot hold the currents: {', '.join(wrong[:_MOST_NAMED])}"
        if wrong
        else told or "all that answer hold real numbers",
        "name the PVs of the currents [A] in the places table, records of type ao"
        if wrong
        else "is that meant? Records of type ao hold any current"
        if told
        else "",
        {"not_real": list(wrong)},
    )


def _drive_limits(context: Context, group: ChannelGroup, config: AppConfig) -> Finding:
    """Tell whose drive limits are narrower than ours."""
    limits = Getter(context, group, config.epics.answer_timeout).limits()
    told = narrower(config.limits.setpoint, limits, group.names)
    return Finding(
        _PART,
        "drive limits",
        Verdict.WARNING if told else Verdict.OK,
        told or f"none is narrower than limits.setpoint = {config.limits.setpoint:g} A",
        "is that meant? See DRVL and DRVH of these records" if told else "",
    )
