"""The PVs of the RF frequency that follows, and of the hand-over to a fast feedback."""

from orbitfb.panel.pv import Kind, PanelPv
from orbitfb.panel.pvs.forms import choice_pv, count_pv, number_pv, text_pv


def frequency_pvs() -> tuple[PanelPv, ...]:
    """Give those of the RF, names without prefix."""
    orders = [{"command": "rf", "follow": follow} for follow in (True, False)]
    return (
        PanelPv(
            "RfState-I",
            Kind.CHOICE,
            "Whether the RF frequency follows the energy; STOPPED is a MINOR alarm.",
            states=("OFF", "FOLLOWS", "STOPPED"),
            minor=("STOPPED",),
        ),
        text_pv("RfReason-I", "Why the frequency does not follow, or waits."),
        number_pv("RfFrequency-I", "Frequency that the loop has set, or found.", "Hz", 3),
        number_pv("RfStep-I", "Last step of the frequency.", "Hz", 3),
        count_pv("RfSteps-I", "Steps of the frequency since the start."),
        number_pv(
            "RfEnergy-I", "Energy that the correctors make since the loop settled.", "1e-6", 3
        ),
        number_pv("RfColumn-I", "RF column in use, over that of the places table.", "1", 3),
        *(
            number_pv(f"RfFound{end}-I", f"RF column as the last refit found it, {what}.", "1", 3)
            for end, what in (
                ("", "over that of the places table"),
                ("Low", "lower end of its 95 % interval"),
                ("High", "upper end of its 95 % interval"),
            )
        ),
        choice_pv(
            "Rf-Cmd",
            "Lets the frequency follow, or leaves it alone.",
            ("-", "follow", "leave"),
            *orders,
        ),
    )


def hand_over_pvs() -> tuple[PanelPv, ...]:
    """Give those of the hand-over to a fast feedback, names without prefix."""
    return (
        PanelPv(
            "HandOver-I",
            Kind.CHOICE,
            "Whether our reference is handed to a fast feedback; STOPPED is a MINOR alarm.",
            states=("OFF", "HANDS OVER", "STOPPED"),
            minor=("STOPPED",),
        ),
        text_pv("HandOverReason-I", "Why it is not handed over, or waits."),
        number_pv("HandOverLeft-I", "Largest difference of the two references.", "um", 3),
    )
