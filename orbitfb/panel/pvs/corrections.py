"""The PVs of one correction by hand: compute, look, apply, undo."""

from orbitfb.panel.pv import PanelPv
from orbitfb.panel.pvs.forms import ONCE, choice_pv, count_pv, number_pv, text_pv

LAWS = ("baseline", "active")
"""Laws that compute a correction, as the command `correct` names them."""


def correction_pvs() -> tuple[PanelPv, ...]:
    """Give them all, names without prefix."""
    return (
        choice_pv(
            "CorrectCompute-Cmd",
            "Computes a correction of an open loop by the SVD law, or by the policy in force; "
            "nothing moves.",
            ("-", *LAWS),
            *({"command": "correct", "law": law} for law in LAWS),
        ),
        choice_pv(
            "CorrectApply-Cmd",
            "Applies what was computed, in limited steps; acknowledged when it is there.",
            ONCE,
            {"command": "correct-apply"},
        ),
        choice_pv("Undo-Cmd", "Undoes the last correction by hand.", ONCE, {"command": "undo"}),
        count_pv("Undos-I", "Corrections by hand that can be undone."),
        text_pv("CorrectText-I", "Result of the last correction or undo."),
        number_pv("CorrectRms-I", "Change that was computed, rms.", "A", 6),
        number_pv("CorrectMax-I", "The same, largest.", "A", 6),
        number_pv("CorrectNow-I", "Rms orbit error when it was computed.", "um", 3),
        number_pv("CorrectOrbit-I", "Rms orbit error expected after it.", "um", 3),
    )
