"""The account of what was learnt from since a policy is in force."""

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.models.absorbed import Absorbed
from orbitfb.models.linear import LinearModel
from orbitfb.models.rows import Rows


class Since:
    """What was taken in since a policy is in force.

    Args:
        policy_id: That policy; None when none is known yet.

    Attributes:
        page: Page's sum of the evidence for R̂, each row before it was used, against the response
            of that policy [nats]. While that response is the ring's, it passes E once in e^E
            looks at most: a likelihood ratio has the mean 1 then, whatever R̂ is.
    """

    def __init__(self, policy_id: str | None) -> None:
        self.policy_id = policy_id
        self.rows = 0
        self.kicks = 0
        self.nats = 0.0
        self.page = 0.0
        self.change_square = 0.0
        self.hertz_square = 0.0
        self.rf_steps = 0
        self.chi2 = float("nan")
        self.asked = False
        self.chi2_incumbent = float("nan")
        self.dither_pull = 0.0
        self.dither_information = 0.0
        self.left_out: dict[str, int] = {}

    def add(self, rows: Rows, absorbed: Absorbed, surprise: float | None) -> None:
        """Count rows, and what the identifier made of them.

        Rows that R̂ does not explain either say nothing for it: whatever the ring did there, it was
        the answer of neither response.

        Args:
            rows: That taught.
            absorbed: What they say.
            surprise: Mean squared normalised innovation from which R̂ does not explain them [1];
                None: it is not asked.
        """
        self.asked = surprise is not None
        for reason, count in rows.left_out.items():
            self.left_out[reason] = self.left_out.get(reason, 0) + count
        if absorbed.rows == 0:
            return
        self.rows += absorbed.rows
        self.kicks += absorbed.kicks
        nats = absorbed.rows * absorbed.nats
        if surprise is not None and absorbed.chi2 > surprise:
            nats = min(nats, 0.0)
        self.nats += nats
        self.page = max(0.0, self.page + nats)
        self.change_square += float(np.sum(rows.change**2))
        if rows.hertz is not None:
            self.hertz_square += float(np.sum(rows.hertz**2))
            self.rf_steps += int(np.count_nonzero(rows.hertz))
        self.dither_pull += absorbed.dither_pull
        self.dither_information += absorbed.dither_information
        self.chi2, self.chi2_incumbent = absorbed.chi2, absorbed.chi2_other

    def take_nats(self) -> float:
        """Give the evidence for R̂ since the last judgement, and begin anew."""
        nats, self.nats = self.nats, 0.0
        return nats

    def figures(self) -> dict[str, float]:
        """Give the figures for a report, by name."""
        dither = {}
        if self.dither_information > 0.0:
            dither["dither_gain"] = 1.0 + self.dither_pull / self.dither_information
            dither["dither_gain_sigma"] = self.dither_information**-0.5
        return dither | {
            "rows_left_out": float(sum(self.left_out.values())),
            "kicks": float(self.kicks),
            "chi2": self.chi2,
            "chi2_incumbent": self.chi2_incumbent,
        }


def model_figures(model: LinearModel, before: Vector) -> dict[str, float]:
    """Give the figures of a posterior for a report, by name.

    Args:
        model: The posterior.
        before: Response of the incumbent, shape (n, m) [m/A].
    """
    return {
        "reading_noise": float(np.sqrt(model.reading_variance)),
        "ground": float(np.sqrt(np.mean(model.ground_variances))),
        "response_moved": float(np.linalg.norm(model.response - before) / np.linalg.norm(before)),
        "response_uncertainty": float(
            np.sqrt(np.trace(model.row_covariance) * len(before)) / np.linalg.norm(before)
        ),
    }


def counts(left_out: dict[str, int]) -> str:
    """Say how many rows were left out, by reason."""
    if not left_out:
        return "none left out"
    return "left out: " + ", ".join(f"{count} {reason}" for reason, count in left_out.items())
