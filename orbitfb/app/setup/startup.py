"""What is settled before the loop runs: where the ring is, who else uses it, what may not be."""

import os
import socket
import threading
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import ConfigError
from orbitfb.core.files import state
from orbitfb.core.files.ownership import Lock
from orbitfb.core.near_names import did_you_mean
from orbitfb.core.signals import Channels, LoopState
from orbitfb.epics.settings import LOWEST_PORT, PVA_SEARCH_PORT, EpicsSettings, PvaSettings
from orbitfb.loop.excitation.design import check_excitation
from orbitfb.loop.excitation.dither import DitherSettings
from orbitfb.loop.excitation.file import read_excitation
from orbitfb.loop.excitation.movement import Waveform
from orbitfb.measure.response_file import nominal_response
from orbitfb.physics.places import Ring
from orbitfb.policies.masking import mask_of

SIMULATED = "sim"
ENVIRONMENT = "env"
CONFIGURED = "config"
_PLACES = (SIMULATED, ENVIRONMENT, CONFIGURED)
PRODUCTION_PORT = 5064
"""The port of Channel Access that every machine uses unless it says otherwise."""


def start_state(start: str | None, ioc: str) -> LoopState:
    """Turn `--start` into a state; without it, a simulated ring of our own is closed at once.

    Raises:
        ConfigError: A loop cannot start so.
    """
    if start is None:
        return LoopState.CLOSED if ioc == SIMULATED else LoopState.OPEN
    if start.lower() not in ("open", "shadow", "closed"):
        raise ConfigError(f"--start {start}: choose open, shadow or closed")
    return LoopState(start.upper())


def check_duration(duration: float | None) -> None:
    """Refuse a time that no timer can wait.

    Raises:
        ConfigError: It is not above 0, not finite, or beyond what the system's timers know.
    """
    if duration is not None and not 0 < duration < threading.TIMEOUT_MAX:
        raise ConfigError(f"--duration {duration:g}: give a time above 0 s, or leave it out")


def make_directory(directory: Path) -> None:
    """Make the data directory if it is not there.

    Raises:
        ConfigError: It cannot be made, or cannot be written to.
    """
    try:
        state.make_directory(directory)
    except FileExistsError:
        problem = "there is a file of that name"
    except OSError as error:
        problem = error.strerror
    else:
        if os.access(directory, os.W_OK | os.X_OK):
            return
        problem = "it may not be written to"
    raise ConfigError(
        f"data_directory {directory} cannot be used ({problem}); name another with --data"
    )


def find_ring(config: AppConfig, ioc: str) -> EpicsSettings:
    """Say how to reach a ring that somebody else serves.

    Args:
        config: Gives what `ioc` does not say.
        ioc: `env`, `config` or `HOST[:PORT]`; nothing is known yet of a ring of our own, `sim`.

    Raises:
        ConfigError: That is no address, or its host is not known.
    """
    if ioc == SIMULATED:
        return config.epics
    if ioc == ENVIRONMENT:
        update = _from_environment(os.environ)
    elif ioc == CONFIGURED:
        update = {}
    else:
        host, colon, port = ioc.partition(":")
        if not host or any(c.isspace() for c in host) or (colon and not port):
            raise ConfigError(f"--ioc {ioc}: give sim, env, config, HOST or HOST:PORT")
        number = _port(port, f"--ioc {ioc}") if port else config.sim.port
        update = {
            "address_list": host,
            "name_servers": "",
            "auto_address_list": False,
            "server_port": number,
            "pva": PvaSettings(port=config.epics.pva.port if port else config.sim.pva_port),
        }
    settings = config.epics.model_copy(update=update)
    named = settings.address_list.split() or settings.name_servers.split()
    if not named and not settings.auto_address_list:
        raise ConfigError(
            f"--ioc {ioc}: there is nowhere to search for PVs: the address list and the name "
            "servers are empty and EPICS_CA_AUTO_ADDR_LIST is NO; set EPICS_CA_ADDR_LIST, "
            "EPICS_CA_NAME_SERVERS, epics.address_list or epics.name_servers"
        )
    servers_of(settings)
    return settings


def _from_environment(environment: Mapping[str, str]) -> dict[str, object]:
    """Take the network from the EPICS_CA_… variables, as any other client would."""
    name = "EPICS_CA_SERVER_PORT"
    return {
        "address_list": environment.get("EPICS_CA_ADDR_LIST", ""),
        "name_servers": environment.get("EPICS_CA_NAME_SERVERS", ""),
        "auto_address_list": environment.get("EPICS_CA_AUTO_ADDR_LIST", "YES").upper() != "NO",
        "server_port": _port(
            environment.get(name, str(PRODUCTION_PORT)), f"environment variable {name}"
        ),
        "pva": _pva_from_environment(environment),
    }


def _pva_from_environment(environment: Mapping[str, str]) -> PvaSettings:
    """Take where to search over pvAccess from the EPICS_PVA_… variables."""
    name = "EPICS_PVA_BROADCAST_PORT"
    port = environment.get(name, str(PVA_SEARCH_PORT))
    if not (port.isascii() and port.isdigit() and 0 < int(port) < 65536):
        raise ConfigError(f"environment variable {name}: {port!r} is no port; give one to 65535")
    return PvaSettings(
        address_list=environment.get("EPICS_PVA_ADDR_LIST", ""),
        name_servers=environment.get("EPICS_PVA_NAME_SERVERS", ""),
        port=int(port),
    )


def _port(text: str, where: str) -> int:
    if not (text.isascii() and text.isdigit() and LOWEST_PORT <= int(text) < 65536):
        raise ConfigError(
            f"{where}: {text!r} is no port for Channel Access; give one from {LOWEST_PORT} to "
            f"65535 (libca would use {PRODUCTION_PORT}, the usual one of a machine, for any other)"
        )
    return int(text)


def servers_of(settings: EpicsSettings) -> list[str]:
    """Resolve the places where PVs are searched for, `ADDRESS:PORT` each.

    Raises:
        ConfigError: A host is not known; libca would go on without it.
    """
    servers = [f"any:{settings.server_port}"] if settings.auto_address_list else []
    pva = f"{settings.pva.address_list} {settings.pva.name_servers}"
    words = [(word, settings.server_port) for word in settings.searched.split()]
    words += [(word, settings.pva.port) for word in pva.split()]
    for word, usual in words:
        host, _, port = word.partition(":")
        if port and not port.isdigit():
            raise ConfigError(
                f"{word!r} is no address to search for PVs; give HOST or HOST:PORT, and separate "
                "several by blanks"
            )
        try:
            address = socket.gethostbyname(host)
        except (OSError, UnicodeError):
            raise ConfigError(
                f"the host {host!r}{did_you_mean(host, _PLACES)}, where PVs are to be searched "
                "for, is not known; give a name that resolves, or an IPv4 address"
            ) from None
        servers.append(f"{address}:{port or usual}")
    return servers


def take_ring(settings: EpicsSettings, channels: Channels, stack: ExitStack) -> None:
    """Be the only loop of this user that writes to a ring, each plane of it by itself.

    Args:
        settings: Where the ring is; names of one host are one host.
        channels: What would be written.
        stack: Holds the locks.

    Raises:
        OwnershipError: Another one writes to it.
    """
    first = [channels.setpoint_pvs[part.start] for part in channels.corrector_parts.values()]
    for server in servers_of(settings):
        for plane, pv in zip(channels.planes, first, strict=True):
            stack.enter_context(
                Lock(
                    f"ring {server} {pv}",
                    f"the ring at {settings.address_list}, port {settings.server_port}, plane "
                    f"{plane}",
                    "two loops on one ring fight each other; stop the other one first",
                )
            )


def dither_settings(config: AppConfig) -> DitherSettings:
    """Give the dither the seed of the run, unless it has one of its own."""
    own = "seed" in config.dither.model_fields_set
    return config.dither if own else config.dither.model_copy(update={"seed": config.seed})


def questioner(config: AppConfig, ioc: str) -> np.random.Generator | None:
    """Draw what the simulated ring is asked from the seed of the run, so that it can be repeated.

    None at a machine: nobody may foretell what that is asked. The plant and the dither take the
    seed itself, so that this is a stream beside theirs.
    """
    if ioc != SIMULATED:
        return None
    return np.random.default_rng(np.random.SeedSequence(config.seed).spawn(1)[0])


def planned(config: AppConfig, ring: Ring, file: Path, duration: float | None) -> Waveform:
    """Read an excitation and see that the loop can do it.

    Args:
        config: Has the limits, the interlocks, the masks.
        ring: The ring.
        file: What to do.
        duration: Of the run [s]; None: until stopped.

    Raises:
        ConfigError: It cannot be read, is of another ring, is beyond a limit or too long.
    """
    channels = ring.channels(config.ring.planes)
    matrix = nominal_response(ring, config.ring.planes, config.ring.response, config.masks)
    period = config.loop.period
    waveform = read_excitation(file, channels, matrix, period)
    movable = mask_of(channels, config.masks)[1]
    largest = config.interlocks.distortion_rms
    check_excitation(waveform, channels, matrix, config.limits, largest, movable)
    needed = (waveform.wait + len(waveform.excursion) + 1) * period
    if duration is not None and duration < needed:
        raise ConfigError(
            f"--duration {duration:g}: the excitation {file} needs {needed:.4g} s of a closed loop"
        )
    return waveform


def announcement(where: Mapping[str, object], simulated: bool) -> Iterator[str]:
    """Say in a few lines what was started where.

    Args:
        where: `addresses` and `port` of the ring, address of the `metrics` and of the
            `page`, or `metrics_problem` and `page_problem`; `policy` and `policy_reason`, `data`
            directory.
        simulated: Whether the ring is a simulated one of our own.
    """
    addresses, port = where["addresses"], where["port"]
    if simulated:
        local = str(addresses).startswith("127.")
        reach = "only this computer can reach it" if local else "open to the network"
        yield f"simulated ring on {addresses}, port {port} ({reach}; the production port is 5064)"
    else:
        yield f"ring at {addresses or 'every network'}, port {port}"
    if where["metrics"]:
        yield f"metrics and health on {where['metrics']}"
    elif where.get("metrics_problem"):
        yield f"no metrics as yet: {where['metrics_problem']}"
    if "panel" in where:
        yield f"panel of the PVs {where['prefix']}… on {where['panel']}"
    if where.get("page"):
        yield f"operator page on {where['page']}"
    elif where.get("page_problem"):
        yield f"no operator page: {where['page_problem']}"
    yield f"archive, policies and log in {where['data']}"
    yield f"policy {where['policy']}: {where['policy_reason']}"
