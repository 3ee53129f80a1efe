"""What `orbitfb diagnose` does with a measured response."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from orbitfb.loco.schema import ResponseDiagnosis
    from orbitfb.physics.places import Planes

_MOST_SHOWN = 12
_SUFFIXES = (".csv", ".tsv", ".txt", ".npy", ".json", ".safetensors", ".mat")
"""Files that no record is in; records are archives, `.npz` and HDF5."""


@dataclass(frozen=True, slots=True)
class ResponseOptions:
    """Options that are of responses alone.

    Args:
        unit: Of the matrix.
        matrix: Path of the matrix within the file.
        bpm_names: Path of the names of the BPMs, or @FILE.
        corrector_names: Names of the correctors, in the same way.
        transpose: Its rows are correctors.
        noise: Standard deviation of a measured change of an orbit, text with a unit.
        kick: That made it, text with a unit.
        dispersion: Table of the measured dispersion.
        mask: Devices that are left out.
        model: File of the response by another program.
    """

    unit: str | None = None
    matrix: str | None = None
    bpm_names: str | None = None
    corrector_names: str | None = None
    transpose: bool = False
    noise: str | None = None
    kick: str = "100urad"
    dispersion: Path | None = None
    mask: tuple[str, ...] = ()
    model: Path | None = None

    @property
    def given(self) -> bool:
        """Whether one of them was given: then the file is a response."""
        return self != ResponseOptions()


def is_response(path: Path) -> bool:
    """Tell whether a file is a measured response and no record.

    A record has times and setpoints; a response has one matrix. Files of formats that records
    never come in are responses; of `.npz` and HDF5 the names in it tell.
    """
    from orbitfb.core.errors import ExchangeError
    from orbitfb.loco.input.raw import names_inside

    if path.is_dir() or not path.exists():
        return False
    if path.suffix.lower() in _SUFFIXES:
        return True
    try:
        names = names_inside(path)
    except ExchangeError:
        return False  # the reader of records says what is wrong with it
    return bool(names & {"response", "R", "RM", "matrix"}) and not names & {"orbit", "orbits"}


def diagnose_response(
    path: Path,
    options: ResponseOptions,
    planes: "Planes | None",
    places: Path | None,
    ring: Path | None,
    out: Path,
    as_json: bool,
    config: Path | None = None,
) -> None:
    """Fit, diagnose, write and show a measured response."""
    from orbitfb.app.setup.loop_in_force import loop_of
    from orbitfb.cli.diagnosis.progress import progress_bar, told_when_interrupted
    from orbitfb.cli.options import configure
    from orbitfb.core.errors import ConfigError
    from orbitfb.core.units import parse_quantity
    from orbitfb.loco.answer import answer_of
    from orbitfb.loco.growth import growths
    from orbitfb.loco.input.reading import Request, load
    from orbitfb.loco.output.writing import write
    from orbitfb.loco.run import diagnose
    from orbitfb.loco.schema import document
    from orbitfb.physics.places import Ring

    def quantity(option: str, text: str, unit: str) -> float:
        try:
            value = parse_quantity(text, unit)
        except ValueError as error:
            raise ConfigError(f"{option}: {error}") from None
        if not value > 0:
            raise ConfigError(f"{option} {text}: give a number above 0")
        return value

    noise = None if options.noise is None else quantity("--noise", options.noise, "m")
    request = Request(
        path, options.unit, planes, options.matrix, options.bpm_names, options.corrector_names,
        options.transpose, noise, quantity("--kick", options.kick, "rad"), options.dispersion,
        options.mask,
    )  # fmt: skip
    loop, of_loop = None, planes or "xy"
    if config is None:
        known = Ring.load(places, ring)
    else:
        settings = configure(
            config, ring__places=places, ring__parameters=ring, ring__planes=planes
        )
        known, of_loop = settings.ring.load(), settings.ring.planes
        loop = loop_of(settings, known)
    with told_when_interrupted():
        loaded = load(request, known)
        measured, notes, model = loaded.measured, loaded.notes, None
        if options.model is not None:
            its = load(Request(options.model, options.unit, planes), known)
            model = its.measured.at_devices_of(measured)
            measured = measured.known_in(model)
            notes = (*notes, f"the model is that of {options.model.name}", *its.notes)
        with progress_bar(as_json) as progress:
            result = diagnose(known, measured, progress, model)
        growth = growths(known, measured, result.nominal, loop, of_loop)
        answer = answer_of(result, path.name, notes, growth)
        written = write(answer, result, out)
    if as_json:
        print(document(answer), end="")
    else:
        _show(answer, written)


def _show(answer: "ResponseDiagnosis", written: tuple[Path, ...]) -> None:
    def say(text: str) -> None:
        print("".join(sign for sign in text if sign.isprintable()))

    say(f"{answer.state}: {answer.headline}")
    for its in answer.findings[:_MOST_SHOWN]:
        nearly = "" if its.named else "nearly, "
        say(f"  {nearly}{its.kind}: {its.text} ({its.z:.3g} σ, P {its.probability:.3g})")
    if len(answer.findings) > _MOST_SHOWN:
        say(f"  and {len(answer.findings) - _MOST_SHOWN} more, in diagnosis.json")
    for block in answer.blocks:
        steps = " → ".join(
            f"{name} {100 * value:.3g} %"
            for name, value in (
                ("table", block.raw), ("scale", block.scale), ("gains", block.gains),
                ("fit", block.optics),
            )
            if value is not None
        )  # fmt: skip
        known = "noise" if block.noise_known else "noise as the fit leaves it"
        say(
            f"{block.read} by {block.driven}: {steps}; {known} {100 * (block.noise or 0):.3g} %; "
            f"χ² per value {block.chi2_before:.4g} → {block.chi2_after:.3g}; "
            f"{block.outliers} outliers"
        )
    for its in answer.optics:
        say(
            f"plane {its.plane}: tune {its.tune_table:.5f} → {its.tune_fit:.5f}, β-beat "
            f"{100 * (its.beta_beat_rms or 0):.2g} % rms, correctors {its.scale:.4g} times the "
            "table"
        )
    for its in (*answer.growth,):
        say(its.text)
    if not answer.converged:
        say(f"the fit had not arrived after {answer.steps} steps")
    for note in answer.notes:
        say(f"note: {note}")
    for path in written:
        say(f"written: {path}")
