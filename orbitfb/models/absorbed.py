"""What taking in rows came to, for learner, judge and change detector."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from orbitfb.models.comparison import Contrast


@dataclass(frozen=True, slots=True)
class Absorbed:
    """What taking in rows came to.

    Args:
        rows: Rows that taught.
        kicks: Rows taken for a kick of the orbit.
        chi2: Mean squared normalised innovation, predicted before the rows were used; 1 when
            model, uncertainty and noise are right.
        chi2_other: The same for the response it was compared with, without uncertainty.
        nats: Log-likelihood of the rows over that under the other response, both with the
            variance that noise and uncertainty of R̂ predict [nats per row].
        dither_pull: Correlation of the innovations with what R̂ says the dither does, each in
            units of the noise. The dither is an instrument: it owes nothing to the noise.
        dither_information: The same correlation if R were larger than R̂ by one; pull over
            information is the share by which R exceeds R̂, known to 1/√information.
        contrasts: One for every block: whether R has changed from the response that was compared
            with; none if none was. For `orbitfb.models.changes.ChangeDetector`.
    """

    rows: int
    kicks: int
    chi2: float
    chi2_other: float
    nats: float
    dither_pull: float = 0.0
    dither_information: float = 0.0
    contrasts: tuple[Contrast, ...] = field(default=())


def total(pieces: Sequence[Absorbed]) -> Absorbed:
    """Add up consecutive blocks; means are weighted by the rows."""
    weights = np.array([piece.rows for piece in pieces], dtype=np.float64)
    share = weights / max(weights.sum(), 1.0)
    return Absorbed(
        rows=int(weights.sum()),
        kicks=sum(piece.kicks for piece in pieces),
        chi2=float(share @ [piece.chi2 for piece in pieces]),
        chi2_other=float(share @ [piece.chi2_other for piece in pieces]),
        nats=float(share @ [piece.nats for piece in pieces]),
        dither_pull=sum(piece.dither_pull for piece in pieces),
        dither_information=sum(piece.dither_information for piece in pieces),
        contrasts=tuple(contrast for piece in pieces for contrast in piece.contrasts),
    )
