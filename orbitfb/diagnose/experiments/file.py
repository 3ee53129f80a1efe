"""A planned experiment, and the file of its excitation that `orbitfb run --excite` executes."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from orbitfb.core.errors import EstimationError, RecordError
from orbitfb.core.files.state import AS_USUAL
from orbitfb.core.files.whole import replace_file
from orbitfb.diagnose.experiments.proposals import channels_of
from orbitfb.diagnose.result.parts import Experiment
from orbitfb.loop.excitation.design import ExcitationSettings, design
from orbitfb.loop.excitation.movement import Waveform
from orbitfb.records.layout import Layout


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """An experiment.

    Args:
        experiment: As it is reported.
        settings: What to run; None when no excitation helps.
        layout: Of the record.
    """

    experiment: Experiment
    settings: ExcitationSettings | None
    layout: Layout

    def waveform(self) -> Waveform:
        """Make the excursion that is run.

        Raises:
            EstimationError: No excitation helps.
        """
        channels, layout = channels_of(self.layout), self.layout
        return design(self._runnable, channels, layout.response, layout.period)

    @property
    def _runnable(self) -> ExcitationSettings:
        if self.settings is None:
            raise EstimationError(f"there is no excitation to run: {self.experiment.text}")
        return self.settings

    def write(self, path: Path) -> None:
        """Write what `orbitfb run --excite` reads: an `.npz` waveform, else a description.

        An experiment is never half in its file: a machine executes what is there.

        Raises:
            EstimationError: No excitation helps.
            RecordError: The file cannot be written.
        """
        if path.suffix == ".npz":
            content = self._npz()
        else:
            content = _toml(self.experiment.text, self._runnable).encode()
        try:
            replace_file(path, content, AS_USUAL)
        except OSError as error:
            raise RecordError(f"{path}: it cannot be written ({error.strerror})") from error

    def _npz(self) -> bytes:
        waveform, devices = self.waveform(), self.layout.correctors
        moved = waveform.excursion.any(axis=0)
        file = io.BytesIO()
        np.savez_compressed(
            file,
            waveform=waveform.excursion[:, moved],
            corr_names=np.array(devices.names)[moved],
            planes=np.array(devices.planes)[moved],
            start_s=np.float64(waveform.wait * self.layout.period),
        )
        return file.getvalue()


def check_file(path: Path) -> None:
    """Check that a plan can be written, before the search for it.

    Raises:
        RecordError: The path is a directory, its directory does not exist, or its ending is
            neither `.toml` nor `.npz`.
    """
    if path.is_dir():
        raise RecordError(f"--out {path}: this is a directory; name a file in it")
    if not path.parent.is_dir():
        raise RecordError(f"--out {path}: there is no directory {path.parent}; make it first")
    if path.suffix not in (".toml", ".npz"):
        raise RecordError(
            f"--out {path}: `orbitfb run --excite` reads files that end in .toml (a description) "
            f"or .npz (a waveform), not in {path.suffix or 'nothing'!r}; give the file one of "
            "these endings"
        )


def _toml(text: str, settings: ExcitationSettings) -> str:
    lines = [f"# {text}", f"start = {settings.start!r}", f"seed = {settings.seed}"]
    for part in settings.part:
        lines += ["", "[[part]]", f'kind = "{part.kind}"']
        if part.modes:
            lines.append(f"modes = {list(part.modes)}")
        else:
            quoted = ", ".join(f'"{name}"' for name in part.correctors)
            lines += [f"correctors = [{quoted}]", f'planes = "{part.planes}"']
        lines.append(f"amplitude = [{', '.join(f'{each:.9g}' for each in part.amplitude)}]")
        if part.kind == "ladder":
            lines.append(f"levels = [{', '.join(f'{each:.6g}' for each in part.levels)}]")
        lines += [f"hold = {part.hold}", f"duration = {part.duration!r}"]
    return "\n".join(lines) + "\n"
