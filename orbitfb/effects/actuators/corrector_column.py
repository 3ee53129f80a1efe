"""Corrector whose column of the response is not that of the model."""

from orbitfb.effects.element_kinds import ElementsKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Devices, Layout


class CorrectorColumn(ElementsKind):
    """A column of R is wrong, in no way that a calibration describes."""

    id = "corrector-column"
    target = "corrector"
    title = "corrector that is not of this model"
    sentence = (
        "The response of the BPMs to the corrector is not that of the model, and no calibration "
        "corrects it. The corrector stands elsewhere, its coils are exchanged, or its column of "
        "the response matrix was measured wrongly. Measure its column again, or leave the "
        "corrector out."
    )
    equation = "x_i = Σ_j (R_ij + ε_ij) θ_j, with an error ε_ij of its own for every BPM i"
    confused_with = (
        "corrector-gain",
        "corrector-roll",
        "corrector-crosstalk",
        "quadrupole-gradient",
    )
    splits = "Steps of this corrector alone. They measure the column element by element."

    def table(self, response: Matrix) -> Matrix:
        """Columns of the response."""
        return response.T

    def devices(self, layout: Layout) -> tuple[Devices, Devices]:
        """Correctors; BPMs."""
        return layout.correctors, layout.bpms
