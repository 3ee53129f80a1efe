"""All PVs of the panel."""

from dataclasses import dataclass

from orbitfb.core.signals import LoopState
from orbitfb.panel.pv import LONGEST_TEXT, Kind, Order, PanelPv
from orbitfb.panel.settings import PanelSettings

MILLI, MICRO = 1e-3, 1e-6
UNKNOWN_STATE = "STARTING"
STATES = (UNKNOWN_STATE, *(state.value for state in LoopState))
"""States that `State-I` shows."""
COMMANDS = ("-", "open", "shadow", "close", "reset")
REFITS = ("-", "refit", "refit and activate")
ONCE = ("-", "do")


@dataclass(frozen=True, slots=True)
class Extent:
    """What the table depends on besides the settings.

    Args:
        planes: x, y or xy.
        bpms: Length of an orbit.
        correctors: Length of a set of setpoints.
    """

    planes: str
    bpms: int
    correctors: int


def panel_pvs(settings: PanelSettings, extent: Extent) -> tuple[PanelPv, ...]:
    """Give every PV of a panel, names without prefix.

    Args:
        settings: Has the limits.
        extent: Of the ring under feedback.
    """
    return (*_loop(), *_figures(extent), *_policies(), *_adjustments(settings, extent))


def writable_names(pvs: tuple[PanelPv, ...]) -> tuple[str, ...]:
    """Give the names of those that can be written."""
    return tuple(pv.name for pv in pvs if pv.writable)


def _text(name: str, meaning: str, order: Order | None = None) -> PanelPv:
    return PanelPv(name, Kind.TEXT, meaning, length=LONGEST_TEXT, order=order)


def _number(name: str, meaning: str, units: str, precision: int) -> PanelPv:
    return PanelPv(name, Kind.DOUBLE, meaning, units, precision)


def _count(name: str, meaning: str) -> PanelPv:
    return PanelPv(name, Kind.INTEGER, meaning)


def _choice(name: str, meaning: str, states: tuple[str, ...], *requests: object) -> PanelPv:
    choices = tuple(dict(request) if isinstance(request, dict) else None for request in requests)
    return PanelPv(
        name, Kind.CHOICE, meaning, states=states, order=Order("", choices=(None, *choices))
    )


def _loop() -> tuple[PanelPv, ...]:
    orders = [{"command": name} for name in COMMANDS[1:]]
    return (
        PanelPv("State-I", Kind.CHOICE, "State of the loop.", states=STATES),
        _choice("Command-Cmd", "Commands the loop.", COMMANDS, *orders),
        _choice(
            "Reset-Cmd",
            "Resets a loop that tripped; it is OPEN then.",
            ONCE,
            {"command": "reset"},
        ),
        _text("Reason-I", "Why the loop is in its state; empty when there is nothing to say."),
        _text("LastTrip-I", "When and why the loop tripped last; stays after a reset."),
        _count("Heartbeat-I", "Grows at every update while the loop ticks; else INVALID."),
        _text("Version-I", "Version of orbitfb."),
        _text("LogLine-I", "The last thing that happened: states, policies, commands, refusals."),
        _text("PVs-I", "Names of all PVs of the panel, a JSON list."),
        _text("Lease-I", "Who holds the lease of the machine; empty: there is no lease."),
    )


def _figures(extent: Extent) -> tuple[PanelPv, ...]:
    rms = tuple(
        _number(f"Rms{plane.upper()}-I", f"Rms orbit error of the last orbit, {plane}.", "um", 3)
        for plane in extent.planes
    )
    phases = tuple(
        _number(f"Tick{word.capitalize()}-I", f"{meaning}, mean since the last update.", "ms", 3)
        for word, meaning in (
            ("read", "Wait for the orbit"),
            ("check", "Interlocks"),
            ("decide", "Policy"),
            ("limit", "Limits"),
            ("act", "Write"),
        )
    )
    return (
        *rms,
        _count("BpmsInvalid-I", "BPMs of the last orbit that do not count though they should."),
        _count("Ticks-I", "Ticks since the start."),
        _count("Missed-I", "Orbits that should have come and did not."),
        *phases,
        _number("Period-I", "Mean time from orbit to orbit.", "ms", 3),
        _number("Jitter-I", "Standard deviation of that time.", "ms", 3),
        _number("Latency50-I", "From orbit to last setpoint sent, median.", "ms", 3),
        _number("Latency99-I", "The same, 99th percentile.", "ms", 3),
        _number("LatencyMax-I", "The same, largest since the start.", "ms", 3),
        _number("Gap-I", "Gap between model and machine.", "nats", 3),
        _text("GapText-I", "The gap in a sentence."),
    )


def _policies() -> tuple[PanelPv, ...]:
    refits = [{"command": "refit", "activate": activate} for activate in (False, True)]
    return (
        _text("Policy-I", "Id of the policy that decides."),
        _text("LastRefit-I", "What the last refit came to."),
        _choice(
            "Refit-Cmd",
            "Refits now; the write is acknowledged when the decision is there.",
            REFITS,
            *refits,
        ),
        _choice(
            "RollBack-Cmd",
            "Puts the policy in force that was before.",
            ONCE,
            {"command": "activate", "policy": None},
        ),
        _text("Activate-Cmd", "Puts the policy of this id in force.", Order("activate", "policy")),
    )


def _adjustments(settings: PanelSettings, extent: Extent) -> tuple[PanelPv, ...]:
    return ()
