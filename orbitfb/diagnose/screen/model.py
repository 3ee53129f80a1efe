"""Units, and whether the model is that of the ring whose names the devices have."""

import numpy as np

from orbitfb.diagnose.screen.steps import Steps, steps_of
from orbitfb.physics.optics import Matrix
from orbitfb.records.finding import Finding
from orbitfb.records.layout import ChannelPlane
from orbitfb.records.reading.devices import Named, correlation, ring_block
from orbitfb.records.record import Record

LARGEST_ORBIT = 0.05
"""No beam pipe lets an orbit of this rms pass [m]."""

_SOME = 10
"""Part of a record, from its beginning, that another unit would have made too large too."""
_TOO_STILL = 0.02
_TOO_WILD = 200.0
_SURE = 5.0
_LIKE = 0.9
_UNLIKE = 0.7
_TURNED = 0.98
_CLOSER = 0.1
_STRANGE = 0.5
_MOST = 0.9
_FEWEST = 20
_SCALE = 30.0


def check_units(record: Record) -> list[Finding]:
    """Compare the size of the orbit with a beam pipe, and its steps with the model's."""
    rms = float(np.sqrt(np.mean(record.readings**2)))
    wide = np.sqrt(np.mean(record.readings**2, axis=1)) > LARGEST_ORBIT
    if rms > LARGEST_ORBIT and not wide[: len(wide) // _SOME].any():
        row = int(np.argmax(wide))
        text = (
            f"from row {row} on array 'orbit' is larger than a beam pipe ({rms * 1e3:.3g} mm rms "
            "over all rows): the loop ran away; cut the record before that row"
        )
        return [Finding("lost-beam", "failure", (), (row, len(wide) - 1), text)]
    if rms > LARGEST_ORBIT:
        text = (
            f"the orbit is {rms * 1e3:.3g} mm rms, larger than a beam pipe: is it in µm or nm "
            "instead of mm? Correct the array, or say so in meta: units.orbit"
        )
        return [Finding("wrong-units", "failure", (), None, text)]
    steps = steps_of(record)
    seen, made, alike = _quiet_sizes(steps)
    if made == 0.0 or len(steps.first) < _FEWEST:
        text = "no setpoint moves, so the record says nothing about the correctors and the response"
        return [Finding("no-action", "warning", (), None, text)] if made == 0.0 else []
    if 0.0 < seen < _TOO_STILL * made and alike > _MOST:
        text = (
            f"the orbit moves by {seen * 1e6:.3g} µm per tick, the model predicts "
            f"{made * 1e6:.3g} µm: is the orbit in m instead of mm, or are the currents in mA "
            "instead of A? Correct the array, or say so in meta: units"
        )
        return [Finding("wrong-units", "failure", (), None, text)]
    slope, error = _instrumented_slope(steps)
    if slope > _TOO_WILD and slope > _SURE * error:
        text = (
            f"the orbit moves {slope:.3g} times as far as the model predicts: is model_R in m/A "
            "instead of mm/A, or the orbit in µm instead of mm? Correct the array, or say so in "
            "meta: units"
        )
        return [Finding("wrong-units", "failure", (), None, text)]
    return []


def _quiet_sizes(steps: Steps) -> tuple[float, float, float]:
    """Size of the steps of the orbit and of the model's, and share of BPMs that go along with it.

    Taken from the quieter half of the rows: a loop that runs away through swapped or turned
    correctors moves them far and the orbit little in the end, but not from the beginning.
    """
    moves = np.mean(steps.predicted**2, axis=1)
    quiet = (moves <= np.median(moves[moves > 0])) & (moves > 0) if moves.any() else moves > 0
    if not quiet.any():
        return 0.0, 0.0, 0.0
    orbit, predicted = steps.orbit[quiet], steps.predicted[quiet]
    along = np.sum(orbit * predicted, axis=0) > 0
    seen, made = np.sqrt(np.mean(orbit**2)), np.sqrt(np.mean(predicted**2))
    return float(seen), float(made), float(np.mean(along))


def _instrumented_slope(steps: Steps) -> tuple[float, float]:
    """Regress the orbit's steps on the model's, with the step before as the instrument.

    The noise of a reading is in the action after it, so the plain slope of a quiet record is far
    above 1; the step before knows nothing of that noise.
    """
    joined = np.flatnonzero(np.diff(steps.first) == 1) + 1
    instrument = steps.predicted[joined - 1]
    strength = np.sum(instrument * steps.predicted[joined])
    if strength == 0.0:
        return 0.0, np.inf
    slope = float(np.sum(instrument * steps.orbit[joined]) / strength)
    # Rows, not readings, are independent: neighbours move together.
    rest = np.sum(instrument * (steps.orbit[joined] - slope * steps.predicted[joined]), axis=1)
    return slope, float(np.sqrt(np.sum(rest**2)) / abs(strength))


def check_model(record: Record) -> list[Finding]:
    """Compare the model with the optics of the ring that the names belong to."""
    ring = record.layout.ring
    if ring is None:
        return []
    bpms, correctors = record.layout.bpms, record.layout.correctors
    found: list[Finding] = []
    for plane in record.layout.planes:
        rows, columns = bpms.in_plane(plane), correctors.in_plane(plane)
        if not len(rows) or not len(columns):
            continue
        block = record.layout.response[np.ix_(rows, columns)]
        named = (
            Named("bpm_names", tuple(bpms.names[int(i)] for i in rows), ()),
            Named("corr_names", tuple(correctors.names[int(i)] for i in columns), ()),
        )
        other: ChannelPlane = "y" if plane == "x" else "x"
        own = ring_block(ring, *named, plane)
        found += _compare(block, own, ring_block(ring, *named, other), plane)
    return found


def _compare(block: Matrix, own: Matrix, other: Matrix, plane: ChannelPlane) -> list[Finding]:
    likeness = correlation(block, own)
    if likeness < _UNLIKE and correlation(block, other) > _LIKE:
        text = (
            f"the columns are declared to be in plane {plane}, but model_R is that of the other "
            "plane; correct the planes"
        )
        return [Finding("swapped-planes", "failure", (), None, text)]
    # Where BPMs and correctors alternate a response is nearly symmetric.
    turned = correlation(block.T, own) if block.shape[0] == block.shape[1] else 0.0
    if likeness < _TURNED and 1.0 - turned < _CLOSER * (1.0 - likeness):
        text = f"model_R is transposed in {plane}: rows are BPMs, columns are correctors"
        return [Finding("transposed-model", "failure", (), None, text)]
    if abs(likeness) < _STRANGE:
        text = (
            f"model_R in {plane} does not resemble the optics of the ring that the names belong to "
            f"(correlation {likeness:.2f}): are its rows and columns in the order of the names?"
        )
        return [Finding("strange-model", "warning", (), None, text)]
    scale = float(np.sum(block * own) / np.sum(own**2))
    if abs(scale) > _SCALE or abs(scale) < 1 / _SCALE:
        text = (
            f"model_R in {plane} is {scale:.3g} times that of the ring that the names belong to: "
            "is it in another unit than mm/A?"
        )
        return [Finding("model-scale", "warning", (), None, text)]
    return []
