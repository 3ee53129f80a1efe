"""Pictures of a fitted response."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import AxesImage

from orbitfb.core.signals import Vector
from orbitfb.html.figures import BLUE, GREEN, GREY, ORANGE, RED, picture
from orbitfb.loco.run import Result
from orbitfb.loco.schema import ResponseDiagnosis
from orbitfb.physics.optics import Matrix
from orbitfb.physics.places import Plane


def triple(result: Result, plane: Plane) -> str:
    """Draw measured, fitted and difference on one scale."""
    data = result.mended.response[plane, plane]
    model = result.fit.model[plane]
    limit = float(np.nanpercentile(np.abs(data), 99)) or 1.0
    matrices = (("measured", data), ("fitted", model), ("measured − fitted", data - model))

    def paint(figure: Figure) -> None:
        images: list[AxesImage] = []
        for axes, (title, matrix) in zip(figure.subplots(1, 3), matrices, strict=True):
            images.append(
                axes.imshow(matrix, aspect="auto", cmap="RdBu_r", vmin=-limit, vmax=limit)
            )
            axes.set_title(title)
            axes.set_xlabel("corrector")
            axes.set_ylabel("BPM")
        bar = figure.colorbar(images[0], ax=figure.axes)
        bar.set_label("m/rad")

    return picture(f"Response in {plane}, all three on one scale.", (10.0, 3.2), paint)


def residuals(result: Result, plane: Plane) -> str:
    """Draw what the table and the fit leave of every row and column."""
    data, noise = result.mended.response[plane, plane], result.fit.noise[plane]
    before = np.where(noise.kept, data - result.nominal[plane], np.nan)
    after = np.where(noise.kept, result.fit.residual[plane], np.nan)

    def paint(figure: Figure) -> None:
        for axes, axis, what in zip(figure.subplots(1, 2), (1, 0), ("BPM", "corrector"),
                                    strict=True):  # fmt: skip
            for values, label, colour in (
                (before, "table", GREY),
                (after, "fit", BLUE),
                (np.where(noise.kept, noise.sigma, np.nan), "noise", ORANGE),
            ):
                size = _sizes(values if axis == 1 else values.T)
                axes.semilogy(size, color=colour, label=label, lw=1.0)
            axes.set_xlabel(what)
            axes.set_ylabel("rms residual [m/rad]")
        figure.axes[0].legend()

    return picture(f"Residual in {plane} before and after the fit.", (10.0, 2.6), paint)


def _sizes(values: Matrix) -> Vector:
    """Rms of every row over what is known; NaN where nothing is."""
    count = np.isfinite(values).sum(axis=1)
    total = np.nansum(values**2, axis=1)
    return np.where(count > 0, np.sqrt(total / np.maximum(count, 1)), np.nan)


def along_ring(answer: ResponseDiagnosis) -> str:
    """Draw gains, calibrations and gradients along the ring."""

    def values(items: object) -> np.ndarray:
        return np.array(items, dtype=float)

    def paint(figure: Figure) -> None:
        gains, kicks, gradients = figure.subplots(3, 1, sharex=True)
        for plane, colour in (("x", BLUE), ("y", RED)):
            own = [its for its in answer.bpms if its.plane == plane]
            gains.errorbar(
                values([its.s_m for its in own]), values([its.gain for its in own]),
                values([its.gain_sigma for its in own]), fmt=".", color=colour, ms=4, lw=0.7,
                label=plane,
            )  # fmt: skip
            kick = [its for its in answer.correctors if its.plane == plane]
            kicks.errorbar(
                values([its.s_m for its in kick]), values([its.calibration for its in kick]),
                values([its.calibration_sigma for its in kick]), fmt=".", color=colour, ms=4,
                lw=0.7,
            )  # fmt: skip
        gradients.errorbar(
            values([its.s_m for its in answer.quadrupoles]),
            100 * values([its.relative for its in answer.quadrupoles]),
            100 * values([its.sigma for its in answer.quadrupoles]), fmt=".", color=GREEN, ms=4,
            lw=0.7,
        )  # fmt: skip
        gains.set_ylabel("gain of BPM")
        kicks.set_ylabel("calibration")
        gradients.set_ylabel("ΔK/K [%]")
        gradients.set_xlabel("s [m]")
        gains.legend()

    return picture("Fitted gains, calibrations and gradients with σ.", (10.0, 6.0), paint)
