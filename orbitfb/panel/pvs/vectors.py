"""The PVs with an element for each BPM, corrector or mode, plane by plane."""

from collections.abc import Mapping

from orbitfb.panel.pv import Kind, PanelPv

_BPM_VECTORS = (
    ("Orbit", "mm", 5, "Last orbit; NaN: not valid, or left out."),
    ("Reference", "mm", 5, "Reference orbit in force."),
    ("Error", "um", 3, "Orbit − reference of the last orbit; NaN: not valid, or left out."),
)
_CORRECTOR_VECTORS = (
    ("Setpoint", "A", 5, "Setpoints in force after the last tick; NaN: not known."),
    ("Computed", "A", 6, "Change that policy and dither asked for in the last tick."),
    ("Applied", "A", 6, "Change that the last tick wrote; zeros: nothing was written."),
    ("Shadow", "A", 6, "Change that a loop in SHADOW would write; NaN in every other state."),
    ("Preview", "A", 6, "Change that the correction computed by hand would make; NaN: none."),
    ("Room", "A", 4, "Distance from the setpoint to the nearer limit in force."),
)
_MODES = (
    ("SingularValue", "m/A", 6, "Singular values of the response in force, largest first."),
    (
        "ModeGain",
        "",
        4,
        "Part of a mode of the orbit error that one tick corrects, largest mode first.",
    ),
)


def vector_pvs(lengths: Mapping[str, tuple[int, int]]) -> tuple[PanelPv, ...]:
    """Give them all, names without prefix.

    Args:
        lengths: BPMs and correctors of each plane.
    """
    return tuple(
        pv
        for plane, (bpms, correctors) in lengths.items()
        for pv in _of_plane(plane, bpms, correctors)
    )


def _of_plane(plane: str, bpms: int, correctors: int) -> tuple[PanelPv, ...]:
    letter, modes = plane.upper(), min(bpms, correctors)
    bpm_place, corrector_place = f"BpmPosition{letter}-I", f"CorrectorPosition{letter}-I"

    def numbers(row: tuple[str, str, int, str], length: int, along: str) -> PanelPv:
        name, units, precision, meaning = row
        meaning = f"{meaning[:-1]}; plane {plane}."
        return PanelPv(
            f"{name}{letter}-I", Kind.DOUBLES, meaning, units, precision, length=length, along=along
        )

    def places(name: str, what: str, length: int) -> PanelPv:
        meaning = f"Positions s of the {what} of plane {plane}."
        return PanelPv(name, Kind.DOUBLES, meaning, "m", 4, length=length)

    def names(name: str, what: str, length: int) -> PanelPv:
        meaning = f"Names of the {what} of plane {plane}, in the order of every vector."
        return PanelPv(f"{name}{letter}-I", Kind.NAMES, meaning, length=length)

    def flags(name: str, meaning: str, length: int, along: str) -> PanelPv:
        meaning = f"{meaning}; plane {plane}."
        return PanelPv(f"{name}{letter}-I", Kind.SWITCHES, meaning, length=length, along=along)

    return (
        *(numbers(row, bpms, bpm_place) for row in _BPM_VECTORS),
        *(numbers(row, correctors, corrector_place) for row in _CORRECTOR_VECTORS),
        *(numbers(row, modes, "") for row in _MODES),
        flags("BpmUsed", "1: the BPM counted in the last orbit; 0: it did not", bpms, bpm_place),
        flags(
            "CorrectorUsed", "1: the corrector may move; 0: it may not", correctors, corrector_place
        ),
        places(bpm_place, "BPMs", bpms),
        places(corrector_place, "correctors", correctors),
        names("BpmName", "BPMs", bpms),
        names("CorrectorName", "correctors", correctors),
    )
