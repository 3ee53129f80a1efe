"""The table of faults, as data: what may happen, what the loop answers, by which rule and test.

The page on safety is written from it, and a test looks every setting and every test up.
"""

from dataclasses import dataclass

from orbitfb.core.signals import LoopState

_OPEN, _CLOSED, _HELD, _TRIPPED = (
    LoopState.OPEN,
    LoopState.CLOSED,
    LoopState.HELD,
    LoopState.TRIPPED,
)


@dataclass(frozen=True, slots=True)
class Fault:
    """A row of the table.

    Args:
        event: What happens to a loop that is CLOSED.
        answer: What the loop does.
        states: States in which it may find itself, in their order.
        settings: Keys of the configuration that set it.
        tests: Tests that bring it about, by name.
    """

    event: str
    answer: str
    states: tuple[LoopState, ...]
    settings: tuple[str, ...] = ()
    tests: tuple[str, ...] = ()


FAULTS = (
    Fault(
        "a BPM is disconnected, INVALID, NaN or exactly 0, keeps its stamp or repeats its reading "
        "while others change, or jumps alone",
        "left out within the tick (one that keeps its stamp: after one lost orbit) and named with "
        "the reason, the law solved for the rest; counts "
        "again after a row of good readings; one that jumped, once it reads what it did, or after "
        "the loop was opened",
        (_CLOSED,),
        (
            "epics.stuck_bpms",
            "interlocks.bpm_zero",
            "interlocks.bpm_frozen_ticks",
            "interlocks.bpm_jump",
            "interlocks.bpm_proving",
        ),
        (
            "test_a_bad_bpm_is_left_out_named_and_comes_back",
            "test_a_nan_bpm_is_not_read_as_on_reference",
            "test_a_bpm_that_keeps_its_stamp_is_masked_and_comes_back",
            "test_half_of_the_machine_away_is_masked_and_comes_back",
        ),
    ),
    Fault(
        "more such BPMs than may be, or too many next to each other; those of `masks.bpms` and "
        "disabled ones are not counted",
        "nothing is written until they are back",
        (_HELD, _TRIPPED),
        (
            "interlocks.max_invalid_bpms",
            "interlocks.max_adjacent_bpms",
            "loop.proving",
            "loop.trip_after",
        ),
        (
            "test_three_bad_bpms_in_a_row_hold_until_they_are_back",
            "test_an_orbit_of_zeros_holds",
            "test_held_too_long_trips_and_only_reset_leads_out",
        ),
    ),
    Fault(
        "no coherent orbit, an old one, or the same one again",
        "nothing is written: an old orbit is never acted on",
        (_HELD, _TRIPPED),
        ("loop.hold_after", "interlocks.frozen_ticks", "epics.stale_after", "loop.trip_after"),
        (
            "test_a_frozen_orbit_is_not_integrated",
            "test_a_frozen_ioc_is_noticed_too",
            "test_a_torn_orbit_is_refused_and_the_late_bpm_named",
        ),
    ),
    Fault(
        "a corrector is off, stuck, or its readback is away or beyond the tolerance",
        "left out after some ticks and named, its setpoint stays, the law solved for the others, "
        "its rows teach nobody; counts again when the loop is opened and closed",
        (_CLOSED,),
        (
            "interlocks.readback_tolerance",
            "interlocks.readback_ticks",
            "interlocks.readback_lag",
        ),
        (
            "test_a_corrector_that_does_not_follow_is_left_out",
            "test_a_dead_corrector_does_not_let_setpoints_and_hardware_part_ways",
            "test_rows_of_a_stuck_corrector_do_not_teach_until_it_is_left_alone",
        ),
    ),
    Fault(
        "more correctors than may be lost",
        "TRIPPED; HELD while a readback is away, as its IOC may come back",
        (_HELD, _TRIPPED),
        ("interlocks.max_lost_correctors",),
        ("test_more_correctors_than_may_be_lost_trip",),
    ),
    Fault(
        "a corrector would go beyond its limit",
        "it leaves the solution of this tick and the others take over; named, and warned of before",
        (_CLOSED,),
        ("limits.setpoint", "limits.warning"),
        (
            "test_a_corrector_at_its_limit_leaves_the_solution_and_the_rest_take_over",
            "test_a_corrector_is_warned_of_before_its_limit",
        ),
    ),
    Fault(
        "a step larger than allowed",
        "the whole vector is shortened, its direction kept",
        (_CLOSED,),
        ("limits.change_per_tick",),
        ("test_limits_hold_for_any_finite_input",),
    ),
    Fault(
        "the policy raises, or asks for something that is not finite or of another shape",
        "the SVD baseline decides from this tick on, until another policy is put in force or the "
        "loop is closed anew; nothing that is not finite is ever sent",
        (_CLOSED,),
        (),
        (
            "test_the_baseline_decides_in_the_very_tick_in_which_a_policy_fails",
            "test_nothing_non_finite_ever_leaves",
            "test_nan_does_not_pass_a_clamp",
        ),
    ),
    Fault(
        "the policy decides too late",
        "the baseline decides at this tick; after three in a row from then on",
        (_CLOSED,),
        ("loop.policy_deadline",),
        ("test_a_slow_policy_is_put_aside_after_three_strikes",),
    ),
    Fault(
        "the stored current is too low, drops, is not known or old",
        "TRIPPED in the same tick, setpoints stay, post-mortem",
        (_TRIPPED,),
        (
            "interlocks.current_min",
            "interlocks.current_drop",
            "epics.auxiliary",
        ),
        ("test_the_stored_current_trips",),
    ),
    Fault(
        "the orbit error is too large (rms, largest)",
        "TRIPPED",
        (_TRIPPED,),
        ("interlocks.distortion_rms", "interlocks.distortion_max"),
        ("test_distortion_lets_pass_only_what_is_known_to_be_small",),
    ),
    Fault(
        "the response is wrong: sign, exchanged BPMs or correctors",
        "TRIPPED after a few ticks: the orbit does not answer as predicted nor get better, "
        "or it grows tick by tick",
        (_TRIPPED,),
        (
            "interlocks.prediction_ticks",
            "interlocks.prediction_least",
            "interlocks.prediction_floor",
            "interlocks.divergence_ticks",
            "interlocks.divergence_factor",
        ),
        (
            "test_a_wrong_response_is_found_before_the_orbit_is_lost",
            "test_a_wrong_response_trips_a_few_ticks_after_closing",
        ),
    ),
    Fault(
        "somebody else moves a setpoint, a write fails, or the setpoints are not known",
        "nothing is written until they are read again",
        (_HELD, _TRIPPED),
        ("loop.trip_after",),
        (
            "test_an_operator_who_moves_a_corrector_is_not_fought",
            "test_a_failed_write_holds_and_what_is_in_force_is_asked_for",
        ),
    ),
    Fault(
        "the IOC or the network is gone and comes back",
        "nothing is written meanwhile, setpoints and drive limits are read again before closing",
        (_HELD, _TRIPPED),
        ("loop.proving", "loop.reclose", "loop.trip_after"),
        ("test_killed_ioc_holds_the_loop_until_it_is_back",),
    ),
    Fault(
        "the controller is killed",
        "setpoints stay; it starts OPEN, or closes again if so told",
        (_OPEN,),
        (),
        (
            "test_setpoints_stay_when_the_controller_is_killed",
            "test_restart_closes_by_itself_without_a_bump_if_so_told",
        ),
    ),
    Fault(
        "another controller writes",
        "the second refuses to start; a lease that was lost opens the loop",
        (_OPEN,),
        ("lease.pv", "lease.time"),
        ("test_one_of_two_controllers_writes_and_a_stale_lease_is_taken_over",),
    ),
    Fault(
        "an error that nobody foresaw",
        "setpoints stay; start the program again",
        (LoopState.FAULT,),
        (),
        ("test_a_policy_that_raises_is_a_fault_and_writes_nothing",),
    ),
)
"""Every fault that has an answer, most of them brought about by a test on a real IOC."""


def faults_markdown() -> str:
    """Write the table for the page on safety."""
    lines = ["| what is wrong | answer | state | settings |", "|---|---|---|---|"]
    for fault in FAULTS:
        states = ", then ".join(fault.states)
        keys = ", ".join(f"`{key}`" for key in fault.settings)
        lines.append(f"| {fault.event} | {fault.answer} | {states} | {keys} |")
    return "\n".join(lines) + "\n"
