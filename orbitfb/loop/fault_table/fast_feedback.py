"""What may happen beside a fast feedback, and while our reference is handed to it."""

from orbitfb.core.signals import LoopState
from orbitfb.loop.fault_table.row import Fault

FAST_FEEDBACK_FAULTS = (
    Fault(
        "a fast orbit feedback is closed, or its status is not known",
        "A closed loop is HELD until the fast one is open. The command close is refused; where the "
        "fast one is closed and takes our reference, close hands that over, and no corrector is "
        "written.",
        (LoopState.HELD,),
        (
            "interlocks.fast_feedback_channel",
            "epics.auxiliary",
            "fast_feedback.reference_pvs",
        ),
        (
            "test_beside_a_fast_feedback_that_is_closed_nothing_is_written",
            "test_close_is_refused_while_the_fast_feedback_is_closed",
            "test_the_reference_is_handed_over_while_the_fast_feedback_is_closed",
        ),
    ),
    Fault(
        "while our reference is handed over, somebody else sets that of the fast feedback, or its "
        "server refuses, clips or ignores puts",
        "What is there stays. The hand-over is STOPPED (a MINOR alarm on the panel), and names the "
        "BPM. The command close hands over again from there.",
        (LoopState.OPEN,),
        ("fast_feedback.tolerance", "fast_feedback.interval"),
        (
            "test_what_is_not_as_it_was_put_is_let_go",
            "test_the_reference_is_handed_over_while_the_fast_feedback_is_closed",
            "test_records_of_epics_base_take_the_reference_and_keep_what_others_set",
        ),
    ),
    Fault(
        "while our reference is handed over, its array is away, or the lease of the machine is "
        "lost",
        "Nothing is put until both are back; the reason says which. Then it is read before the "
        "next step, and let go if it is not what was put.",
        (LoopState.OPEN,),
        ("fast_feedback.reference_pvs", "lease.pv"),
        ("test_it_ends_with_the_fast_feedback_and_waits_for_what_is_away",),
    ),
    Fault(
        "while our reference is handed over, the fast feedback opens, or its status is not known",
        "The hand-over ends, and its reference stays where it is. It does not begin again, and the "
        "loop does not close, without the command close.",
        (LoopState.OPEN,),
        ("interlocks.fast_feedback_channel",),
        (
            "test_it_ends_with_the_fast_feedback_and_waits_for_what_is_away",
            "test_the_reference_is_handed_over_while_the_fast_feedback_is_closed",
        ),
    ),
    Fault(
        "an array of the fast feedback cannot take our reference: it is away, read-only, of "
        "another length, no array of real numbers, or of an unknown unit",
        "The start is refused, before anything moves, and names the array and the reason.",
        (LoopState.OPEN,),
        ("fast_feedback.reference_pvs", "fast_feedback.unit"),
        (
            "test_an_array_that_cannot_take_it_is_told_before_anything_moves",
            "test_a_reference_that_is_away_is_told_by_its_key",
        ),
    ),
)
"""Rows of the table of faults."""
