"""BPM whose row of the response is not that of the model."""

from orbitfb.effects.element_kinds import ElementsKind
from orbitfb.physics.optics import Matrix
from orbitfb.records.layout import Devices, Layout


class BpmRow(ElementsKind):
    """A row of R is wrong, in no way that a gain describes."""

    id = "bpm-row"
    target = "bpm"
    title = "BPM that is not of this model"
    sentence = (
        "The response of the BPM to the correctors is not that of the model, and no gain corrects "
        "it. The BPM stands elsewhere, cables or buttons are exchanged, or its row of the response "
        "matrix was measured wrongly. Measure its row again, or leave the BPM out."
    )
    equation = "y_i = Σ_j (R_ij + ε_ij) θ_j, with an error ε_ij of its own for every corrector j"
    confused_with = ("bpm-gain", "bpm-roll", "bpm-nonlinearity", "quadrupole-gradient")
    splits = "Steps of one corrector after the other. They measure the row element by element."

    def table(self, response: Matrix) -> Matrix:
        """Rows of the response."""
        return response

    def devices(self, layout: Layout) -> tuple[Devices, Devices]:
        """BPMs; correctors."""
        return layout.bpms, layout.correctors
