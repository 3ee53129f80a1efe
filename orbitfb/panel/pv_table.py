"""All PVs of the panel."""

from dataclasses import dataclass
from typing import Self

from orbitfb.core.signals import Channels, LoopState, parts
from orbitfb.panel.pv import Kind, Order, PanelPv
from orbitfb.panel.pvs.bumps import bump_pvs
from orbitfb.panel.pvs.corrections import correction_pvs
from orbitfb.panel.pvs.forms import (
    MICRO,
    MILLI,
    ONCE,
    choice_pv,
    count_pv,
    number_pv,
    pair_of,
    text_pv,
)
from orbitfb.panel.pvs.frequency import frequency_pvs, hand_over_pvs
from orbitfb.panel.pvs.laws import restraint_pvs, trial_pvs
from orbitfb.panel.pvs.measuring import measuring_pvs
from orbitfb.panel.pvs.vectors import vector_pvs
from orbitfb.panel.settings import PanelSettings

UNKNOWN_STATE = "STARTING"
STATES = (UNKNOWN_STATE, *(state.value for state in LoopState))
"""States that `State-I` shows."""
COMMANDS = ("-", "open", "shadow", "close", "reset")
REFITS = ("-", "refit", "refit and activate")


@dataclass(frozen=True, slots=True)
class Extent:
    """What the table depends on besides the settings.

    Args:
        planes: x, y or xy.
        bpms: Length of an orbit.
        correctors: Length of a set of setpoints.
        bpm_counts: BPMs of each plane; empty: as many in each.
        corrector_counts: Correctors of each plane; empty: as many in each.
    """

    planes: str
    bpms: int
    correctors: int
    bpm_counts: tuple[int, ...] = ()
    corrector_counts: tuple[int, ...] = ()

    @classmethod
    def of(cls, channels: Channels) -> Self:
        """Take it from the names of a ring."""
        return cls(
            channels.planes,
            len(channels.bpms),
            len(channels.correctors),
            channels.bpm_counts,
            channels.corrector_counts,
        )

    def lengths(self) -> dict[str, tuple[int, int]]:
        """Count the BPMs and the correctors of each plane."""
        bpms = parts(self.planes, self.bpms, self.bpm_counts)
        correctors = parts(self.planes, self.correctors, self.corrector_counts)
        return {
            plane: (part.stop - part.start, correctors[plane].stop - correctors[plane].start)
            for plane, part in bpms.items()
        }


def panel_pvs(settings: PanelSettings, extent: Extent) -> tuple[PanelPv, ...]:
    """Give every PV of a panel, names without prefix.

    Args:
        settings: Has the limits.
        extent: Of the ring under feedback.
    """
    return (
        *_loop(),
        *_figures(extent),
        *_policies(),
        *frequency_pvs(),
        *hand_over_pvs(),
        *_adjustments(settings, extent),
        *bump_pvs(settings, extent.planes),
        *correction_pvs(),
        *measuring_pvs(),
        *vector_pvs(extent.lengths()),
    )


def writable_names(pvs: tuple[PanelPv, ...]) -> tuple[str, ...]:
    """Give the names of those that can be written."""
    return tuple(pv.name for pv in pvs if pv.writable)


def _loop() -> tuple[PanelPv, ...]:
    orders = [{"command": name} for name in COMMANDS[1:]]
    return (
        PanelPv(
            "State-I",
            Kind.CHOICE,
            "State of the loop; HELD is a MINOR alarm, TRIPPED and FAULT are MAJOR.",
            states=STATES,
            minor=(LoopState.HELD.value,),
            major=(LoopState.TRIPPED.value, LoopState.FAULT.value),
        ),
        choice_pv("Command-Cmd", "Commands the loop.", COMMANDS, *orders),
        choice_pv(
            "Reset-Cmd",
            "Resets a loop that tripped; it is OPEN then.",
            ONCE,
            {"command": "reset"},
        ),
        text_pv("Reason-I", "Why the loop is in its state; empty when there is nothing to say."),
        text_pv("LastTrip-I", "When and why the loop tripped last; stays after a reset."),
        count_pv("Heartbeat-I", "Grows at every update while the loop ticks; else INVALID."),
        text_pv("Version-I", "Version of orbitfb."),
        text_pv("LogLine-I", "The last thing that happened: states, policies, commands, refusals."),
        text_pv("PVs-I", "Names of all PVs of the panel, a JSON list."),
        text_pv("Lease-I", "Who holds the lease of the machine; empty: there is no lease."),
    )


def _figures(extent: Extent) -> tuple[PanelPv, ...]:
    rms = tuple(
        number_pv(f"Rms{plane.upper()}-I", f"Rms orbit error of the last orbit, {plane}.", "um", 3)
        for plane in extent.planes
    )
    phases = tuple(
        number_pv(f"Tick{word.capitalize()}-I", f"{meaning}, mean since the last update.", "ms", 3)
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
        PanelPv(
            "BpmsInvalid-I",
            Kind.INTEGER,
            "BPMs of the last orbit that should count and do not; any is a MINOR alarm.",
            high=1,
        ),
        count_pv("Ticks-I", "Ticks since the start."),
        count_pv("Missed-I", "Orbits that should have come and did not."),
        *phases,
        number_pv("Period-I", "Mean time from orbit to orbit.", "ms", 3),
        number_pv("Jitter-I", "Standard deviation of that time.", "ms", 3),
        number_pv("Latency50-I", "From orbit to last setpoint sent, median.", "ms", 3),
        number_pv("Latency99-I", "The same, 99th percentile.", "ms", 3),
        number_pv("LatencyMax-I", "The same, largest since the start.", "ms", 3),
        number_pv("Gap-I", "Gap between model and machine.", "nats", 3),
        text_pv("GapText-I", "The gap in a sentence."),
    )


def _policies() -> tuple[PanelPv, ...]:
    refits = [{"command": "refit", "activate": activate} for activate in (False, True)]
    return (
        text_pv("Policy-I", "Id of the policy that decides."),
        text_pv("LastRefit-I", "Result of the last refit."),
        choice_pv(
            "Refit-Cmd",
            "Refits now; the write is acknowledged with the decision.",
            REFITS,
            *refits,
        ),
        choice_pv(
            "RollBack-Cmd",
            "Goes back to the policy that was in force before.",
            ONCE,
            {"command": "activate", "policy": None},
        ),
        text_pv(
            "Activate-Cmd", "Puts the policy of this id in force.", Order("activate", "policy")
        ),
    )


def _adjustments(settings: PanelSettings, extent: Extent) -> tuple[PanelPv, ...]:
    gains = (
        pair
        for plane in extent.planes
        for pair in pair_of(
            PanelPv(
                f"Gain{plane.upper()}",
                Kind.DOUBLE,
                f"Factor of the policy's change, plane {plane}.",
                precision=3,
                limits=(0.0, 1.0),
                order=Order("gain", "value", more=(("plane", plane),)),
            )
        )
    )
    largest = settings.reference_limit / MILLI
    reference = PanelPv(
        "Reference",
        Kind.DOUBLES,
        "Reference orbit, x first, then y; RB: where it is on its way.",
        "mm",
        5,
        limits=(-largest, largest),
        length=extent.bpms,
        order=Order("reference", "values", MILLI),
    )
    return (
        *gains,
        *pair_of(reference),
        text_pv(
            "ReferenceSave-Cmd",
            "Saves the reference under this name.",
            Order("reference-save", "name"),
        ),
        text_pv(
            "ReferenceLoad-Cmd",
            "Loads the reference of this name.",
            Order("reference-load", "name"),
        ),
        text_pv("ReferenceName-I", "Name of the reference; empty: it was set by hand or never."),
        *_switches("BpmEnable", "BPMs that count", "enable-bpms", extent.bpms),
        *_switches(
            "CorrectorEnable", "Correctors that move", "enable-correctors", extent.correctors
        ),
        *pair_of(
            PanelPv(
                "Dither",
                Kind.DOUBLE,
                "Orbit motion that the dither may cause, rms; 0: off.",
                "um",
                3,
                limits=(0.0, settings.dither_limit / MICRO),
                order=Order("dither", "orbit_cost", MICRO),
            )
        ),
        *restraint_pvs(settings, extent.planes),
        *trial_pvs(extent.lengths()),
    )


def _switches(name: str, meaning: str, command: str, length: int) -> tuple[PanelPv, PanelPv]:
    return pair_of(
        PanelPv(
            name,
            Kind.SWITCHES,
            f"{meaning}, x first, then y; 1: yes, 0: no.",
            limits=(0.0, 1.0),
            length=length,
            order=Order(command, "enabled"),
        )
    )
