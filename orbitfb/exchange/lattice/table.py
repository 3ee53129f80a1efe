"""The table of places and the ring parameters of a lattice."""

import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from orbitfb.core.errors import ExchangeError, RingError
from orbitfb.exchange.lattice.reading import Element, Lattice, Optics
from orbitfb.exchange.writing import write_whole
from orbitfb.physics.parameters import parse_parameters
from orbitfb.physics.table import COLUMNS, parse_places

BENDS = ("Dipole", "Bend")
"""Classes that focus and are no places all the same: the optics know them."""


@dataclass(frozen=True, slots=True)
class LatticeRequest:
    """What is wanted of a lattice.

    Args:
        file: The lattice.
        calibration: Kick per ampere of every corrector, x and y [rad/A].
        places: Where the table goes.
        parameters: Where the ring parameters go.
        bpms: Families of BPMs, with * and ?; None: all monitors.
        correctors: Families of correctors; None: all correctors.
        names: Attribute with the name of each element; None: its family, numbered.
        variable: Which of several lattices in the file; None: the only one.
        harmonic: RF periods per turn; None: of the cavities.
        bpm_pv: Form of the PVs of BPMs: `{name}`, and `{plane}` or `{PLANE}`.
        setpoint_pv: Of setpoints.
        readback_pv: Of readbacks.
    """

    file: Path
    calibration: tuple[float, float]
    places: Path
    parameters: Path
    bpms: str | None = None
    correctors: str | None = None
    names: str | None = None
    variable: str | None = None
    harmonic: int | None = None
    bpm_pv: str = "{name}:{PLANE}"
    setpoint_pv: str = "{name}:{PLANE}:SP"
    readback_pv: str = "{name}:{PLANE}:RB"


def import_lattice(request: LatticeRequest) -> dict[str, Any]:
    """Write the table of places and the ring parameters of a lattice.

    Args:
        request: What is wanted.

    Returns:
        What was found and written.

    Raises:
        ExchangeError: pyAT is missing, the file is no lattice, nothing is a BPM or a corrector, or
            what would be written is no ring.
    """
    lattice = Lattice(request.file, request.variable)
    elements = lattice.elements(request.names)
    kinds = [kind_of(element, request) for element in elements]
    where = [index for index, kind in enumerate(kinds) if kind]
    for kind, what in (("BPM", "bpms"), ("COR", "correctors")):
        if kind not in kinds:
            known = ", ".join(sorted({element.family for element in elements})[:12])
            raise ExchangeError(
                f"{request.file}: no element is a {kind}; name their families with --{what}, as "
                f'"BPM*"; there are {known}, …'
            )
    harmonic = request.harmonic or lattice.harmonic
    if harmonic is None:
        raise ExchangeError(
            f"{request.file}: no cavity tells the harmonic number; give it with --harmonic"
        )
    names = names_of([elements[index] for index in where], request)
    optics = lattice.optics(where)
    rows = [
        _row(elements[index], str(kinds[index]), name, optics, number, request)
        for number, (index, name) in enumerate(zip(where, names, strict=True))
    ]
    counts = Counter(str(row["kind"]) for row in rows)
    document = {
        "energy_eV": lattice.energy,
        "circumference_m": optics.circumference,
        "harmonic": harmonic,
        "nu_x": optics.tunes[0],
        "nu_y": optics.tunes[1],
        "alpha_c": optics.alpha_c,
        "counts": dict(counts),
    }
    table, parameters = _csv(rows), json.dumps(document, indent=1) + "\n"
    try:  # nothing is written that a loop would refuse
        parse_parameters(parameters, str(request.parameters))
        parse_places(table, str(request.places), optics.circumference)
    except RingError as error:
        raise ExchangeError(f"{request.file} makes no ring: {error}") from None
    write_whole(request.places, table.encode())
    write_whole(request.parameters, parameters.encode())
    return {
        "places": str(request.places),
        "parameters": str(request.parameters),
        **{kind: counts.get(kind, 0) for kind in ("BPM", "COR", "QUAD", "SEXT")},
        "nu_x": optics.tunes[0],
        "nu_y": optics.tunes[1],
        "circumference_m": optics.circumference,
        "bends_with_gradient": sum(
            element.kind in BENDS and element.gradient != 0.0 for element in elements
        ),
    }


def kind_of(element: Element, request: LatticeRequest) -> str | None:
    """Say which kind of place an element is; None: it is none.

    Args:
        element: Of the lattice.
        request: Names the families of BPMs and correctors.
    """
    if _chosen(element, request.bpms, element.kind == "Monitor"):
        return "BPM"
    if _chosen(element, request.correctors, element.kind == "Corrector"):
        return "COR"
    if element.kind in BENDS:
        return None
    if element.gradient != 0.0:
        return "QUAD"
    return "SEXT" if element.sextupole != 0.0 else None


def names_of(elements: Sequence[Element], request: LatticeRequest) -> list[str]:
    """Give every place a name of its own: that of the lattice, or its family and a number.

    Args:
        elements: The places in their order.
        request: Says which attribute has names.

    Raises:
        ExchangeError: The attribute names some elements not, or several alike.
    """
    if request.names is not None:
        count = Counter(element.name for element in elements)
        if wrong := [
            element for element in elements if not element.name or count[element.name] > 1
        ]:
            first = wrong[0]
            raise ExchangeError(
                f"{request.file}: {request.names} names {len(wrong)} of {len(elements)} places "
                f"not, or several alike: {first.name or 'none'!r} of family {first.family}; leave "
                "--names out, then families are numbered"
            )
        return [element.name for element in elements]
    families = Counter(element.family for element in elements)
    seen: Counter[str] = Counter()
    names: list[str] = []
    for element in elements:
        family = element.family
        seen[family] += 1
        digits = len(str(families[family]))
        single = families[family] == 1
        names.append(family if single else f"{family}_{seen[family]:0{digits}d}")
    return names


def _chosen(element: Element, pattern: str | None, usual: bool) -> bool:
    return usual if pattern is None else fnmatchcase(element.family, pattern)


def _row(
    element: Element, kind: str, name: str, optics: Optics, number: int, request: LatticeRequest
) -> dict[str, object]:
    row: dict[str, object] = dict.fromkeys(COLUMNS, "")
    row |= {
        "name": name,
        "kind": kind,
        "s_m": repr(float(optics.s[number])),
        "beta_x_m": repr(float(optics.beta[0, number])),
        "beta_y_m": repr(float(optics.beta[1, number])),
        "mu_x_2pi": repr(float(optics.phase[0, number])),
        "mu_y_2pi": repr(float(optics.phase[1, number])),
        "eta_x_m": repr(float(optics.dispersion[number])),
        "length_m": repr(element.length),
    }
    if kind in ("QUAD", "SEXT"):
        strength = element.gradient if kind == "QUAD" else element.sextupole
        return row | {"strength": repr(strength)}
    forms = {"pv": request.bpm_pv if kind == "BPM" else request.setpoint_pv}
    if kind == "COR":
        forms["rb"] = request.readback_pv
        for plane, calibration in zip("xy", request.calibration, strict=True):
            row[f"cal_{plane}_rad_per_A"] = repr(calibration)
    for column, form in forms.items():
        for plane in "xy":
            row[f"{column}_{plane}"] = _named(form, name, plane)
    return row


def _named(form: str, name: str, plane: str) -> str:
    """Fill a form in by hand: the braces of a PV's name are none of a form."""
    for mark, text in (("{name}", name), ("{plane}", plane), ("{PLANE}", plane.upper())):
        form = form.replace(mark, text)
    return form


def _csv(rows: Sequence[dict[str, object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows([row[column] for column in COLUMNS] for row in rows)
    return text.getvalue()
