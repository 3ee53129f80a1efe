"""The other competitor of every cause: the forward net, fitted to the same ticks.

The net adds to R what it finds in the readings and changes of the ticks of the fit, whatever it
is: a black box that may be nonlinear (`orbitfb.models.forward.fit`). It learns innovations, so it
is consistent in closed loop; it is judged on a later record like the causes. It learns from the
first four fifths of these ticks; the last fifth tells how much of its answer is to be believed, so
that one that has learnt the noise is taken for what it is worth. Its size and the steps of its
training are fixed by the size of the record: the same record gives the same net.
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from orbitfb.core.errors import EstimationError, TrainingError
from orbitfb.diagnose.bench import Bench
from orbitfb.diagnose.replay import NOMINAL, Model, Replay
from orbitfb.physics.optics import Matrix
from orbitfb.records.record import Record

if TYPE_CHECKING:
    from orbitfb.models.forward.net import ForwardNet
    from orbitfb.models.rows import Rows

_WINDOW = 64
_LEARNT = 0.8
_LEAST_ROWS = 600
_HIDDEN = 64
_BATCH = 512
_WORK = 6e9
"""Multiplications of a training: a few seconds on one core."""
_MOST_STEPS, _LEAST_STEPS = 400, 40
_LEARNING_RATE = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class NetCompetitor:
    """A fitted net, or why there is none.

    Args:
        net: None: there is none.
        note: Why not, or why not all of its answer is believed.
        trust: Share of its answer that is believed, between 0 and 1.
    """

    net: "ForwardNet | None"
    note: str = ""
    trust: float = 1.0

    def extra(self, replay: Replay) -> Matrix | None:
        """Orbit that the net adds to R times the setpoints, shape (N, n) [m].

        What it says of every tick stays: the sum over the ticks of a stretch. It is told the
        predicted orbit, whose noise is not that of the reading, and the change of the setpoints.

        Args:
            replay: The record to be judged on.
        """
        if self.net is None:
            return None
        record = replay.record
        rows = _steps(record)
        orbit = replay.orbit if record.reference is None else replay.orbit - record.reference
        change = np.diff(record.setpoints, axis=0)[rows]
        said = self.net.difference(orbit[:-1][rows], change) - change @ self.net.response.T
        added = np.zeros_like(record.readings)
        added[1:][rows] = said
        total = self.trust * np.cumsum(added, axis=0)
        first = np.maximum.accumulate(np.where(record.starts, np.arange(len(record)), 0))
        return total - total[first]


def fitted_net(bench: Bench, seed: int = 0) -> NetCompetitor:
    """Fit the net to the ticks of the fit.

    Args:
        bench: The record of these ticks.
        seed: Of its weights and draws.
    """
    whole = bench.record
    first = whole.rows(0, round(_LEARNT * len(whole)))
    rows = int(np.sum(_steps(first)))
    if rows < _LEAST_ROWS:
        return NetCompetitor(None, f"not fitted: {rows} ticks to learn from, {_LEAST_ROWS} needed")
    try:
        from orbitfb.models.forward.fit import train_forward
        from orbitfb.models.forward.settings import ForwardSettings
    except ImportError as error:
        return NetCompetitor(None, f"not fitted: {error}")
    n, m = whole.layout.response.shape
    work = 6.0 * _BATCH * _HIDDEN * (2 * n + m)
    settings = ForwardSettings(
        hidden=(_HIDDEN,),
        members=1,
        bootstrap=False,
        window=_WINDOW,
        batch=_BATCH,
        iterations=int(np.clip(_WORK / work, _LEAST_STEPS, _MOST_STEPS)),
        learning_rate=_LEARNING_RATE,
        seed=seed,
        device="cpu",
    )
    try:
        net, _ = train_forward(_rows(first), whole.layout.response, settings)
    except (EstimationError, TrainingError) as error:
        return NetCompetitor(None, f"not fitted: {error}")
    return _trusted(NetCompetitor(net), Replay.of(bench), len(first))


def _trusted(net: NetCompetitor, replay: Replay, begin: int) -> NetCompetitor:
    """Believe as much of a net as the rows from `begin` on say."""
    said = (replay.white(NOMINAL) - replay.white(Model(orbit=net.extra(replay))))[begin:]
    left = replay.white(NOMINAL)[begin:]
    size = float(np.sum(said**2))
    trust = float(np.sum(said * left)) / size if size > 0.0 else 0.0
    trust = min(max(trust, 0.0), 1.0)
    return replace(net, trust=trust, note=f"believed to {trust:.0%}" if trust < 1.0 else "")


def _steps(record: Record) -> np.ndarray:
    """Rows that are followed by one of the same stretch, shape (N − 1,)."""
    return ~record.starts[1:]


def _rows(record: Record) -> "Rows":
    """The record as transitions that teach."""
    from orbitfb.models.rows import Rows

    kept = _steps(record)
    index = np.flatnonzero(kept)
    change = np.diff(record.setpoints, axis=0)[kept]
    difference = np.diff(record.readings, axis=0)[kept]
    reference = np.zeros_like(record.readings) if record.reference is None else record.reference
    dither = np.zeros_like(record.setpoints) if record.dither is None else record.dither
    starts = np.ones(len(index), dtype=np.bool_)
    starts[1:] = np.diff(index) != 1
    return Rows(
        tick=index,
        change=change,
        dither=dither[:-1][kept],
        difference=difference,
        valid=np.ones(difference.shape, dtype=np.bool_),
        starts=starts,
        closed=np.ones(len(index), dtype=np.bool_),
        left_out={},
        orbit=(record.readings - reference)[:-1][kept],
    )
