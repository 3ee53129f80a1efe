"""The table of faults, as data: what may happen, what the loop answers, by which rule and test.

The page on safety is written from it, and a test looks every setting and every test up.
"""

from orbitfb.core.signals import LoopState
from orbitfb.loop.fault import Fault

_OPEN, _CLOSED, _HELD, _TRIPPED = (
    LoopState.OPEN,
    LoopState.CLOSED,
    LoopState.HELD,
    LoopState.TRIPPED,
)


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
        "a corrector is off, stuck, disconnected, or its readback is away or beyond the tolerance",
        "left out after some ticks (at once if its setpoint cannot be written) and named, its "
        "setpoint stays, the law solved for the others, its rows teach nobody; read anew when it "
        "is back; counts again when the loop is opened and closed",
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
            "test_a_corrector_whose_setpoint_is_away_is_left_out_and_read_when_it_is_back",
            "test_a_policy_that_cannot_be_solved_anew_moves_no_corrector_that_is_left_out",
        ),
    ),
    Fault(
        "a change that was sent does not show in the readbacks of the next orbit, though it does "
        "as a rule: puts or orbits are late",
        "that tick is held back, named and counted, so that no error is corrected twice; after as "
        "many ticks as readbacks may lag the setpoints are read again before it goes on",
        (_CLOSED,),
        ("interlocks.readback_lag",),
        (
            "test_one_error_is_corrected_once_while_puts_are_late",
            "test_a_change_that_was_lost_is_found_out_by_asking",
            "test_a_loop_at_a_machine_that_is_always_late_goes_on",
        ),
    ),
    Fault(
        "more correctors than may be lost",
        "TRIPPED; HELD while a readback is away, as its IOC may come back, and until it has "
        "had its ticks to follow",
        (_HELD, _TRIPPED),
        ("interlocks.max_lost_correctors", "interlocks.readback_ticks"),
        (
            "test_more_correctors_than_may_be_lost_trip",
            "test_readbacks_that_come_back_in_waves_with_what_they_said_before_only_hold",
        ),
    ),
    Fault(
        "a corrector would go beyond its limit",
        "it leaves the solution of this tick and the others take over; named, and warned of before",
        (_CLOSED,),
        ("limits.setpoint", "limits.warning"),
        (
            "test_a_corrector_at_its_limit_leaves_the_solution_and_the_rest_take_over",
            "test_a_corrector_is_warned_of_before_its_limit",
            "test_the_others_take_over_from_correctors_at_their_limit_over_channel_access",
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
            "test_a_policy_that_fails_is_replaced_within_the_tick_over_channel_access",
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
        "TRIPPED in the same tick, setpoints stay, post-mortem; a drop trips while HELD too",
        (_TRIPPED,),
        (
            "interlocks.current_min",
            "interlocks.current_drop",
            "epics.auxiliary",
        ),
        ("test_the_stored_current_trips", "test_a_stored_current_that_drops_while_held_trips"),
    ),
    Fault(
        "the orbit error is too large (rms, largest) or grows too fast",
        "TRIPPED; setpoints stay, or go back to the last good ones in limited steps if so "
        "configured: no further once anything is wrong",
        (_TRIPPED,),
        (
            "interlocks.distortion_rms",
            "interlocks.distortion_max",
            "interlocks.distortion_rate",
            "loop.return_after_trip",
            "loop.return_step",
            "loop.return_good",
        ),
        (
            "test_distortion_lets_pass_only_what_is_known_to_be_small",
            "test_an_orbit_that_leaves_too_fast_trips_and_the_setpoints_stay",
            "test_an_orbit_that_is_too_far_away_trips_and_close_is_refused",
            "test_after_a_distortion_the_setpoints_go_back_if_wanted",
            "test_it_stops_at_once_if_anything_is_wrong",
        ),
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
        "nothing is written meanwhile, setpoints and drive limits are read again before closing; "
        "HELD while the drive limits are narrower than ours",
        (_HELD, _TRIPPED),
        ("loop.proving", "loop.reclose", "loop.trip_after", "limits.setpoint"),
        (
            "test_killed_ioc_holds_the_loop_until_it_is_back",
            "test_a_server_that_comes_back_with_narrower_limits_is_not_written_to",
        ),
    ),
    Fault(
        "the disk is full, the directory of archive or log is gone",
        "the loop goes on and says so; ticks and lines wait, the newest ticks are dropped and "
        "counted when too many do; written again when there is room",
        (_CLOSED,),
        (),
        (
            "test_a_full_disk_costs_nothing_but_what_waits_too_long",
            "test_the_process_survives_a_disk_that_is_full_again_and_again",
            "test_a_data_directory_that_is_gone_is_made_again",
            "test_lines_that_a_full_disk_refuses_wait",
        ),
    ),
    Fault(
        "a clock is set: that of this computer, or that of both it and the IOC",
        "the loop goes on and says so, after a few lost orbits if the stamps went back; rules "
        "count by a clock that cannot be set",
        (_CLOSED,),
        (),
        (
            "test_our_clock_is_set_and_the_loop_goes_on",
            "test_both_clocks_are_set_and_the_loop_goes_on",
            "test_a_clock_that_was_set_is_told_and_counted",
        ),
    ),
    Fault(
        "the clock of the IOC alone is set, by more than an orbit may be old",
        "nothing is written until it is right: its orbits might be old",
        (_HELD, _TRIPPED),
        ("epics.stale_after", "loop.trip_after"),
        ("test_the_clock_of_the_ioc_is_set_and_the_loop_goes_on_once_it_is_right",),
    ),
    Fault(
        "a refit is poisoned: bad rows, no excitation, an operator's bump, another reference",
        "such rows are left out and counted by reason; too few are left: refused with the reason; "
        "a policy that makes the loop worse is taken back by itself",
        (_CLOSED,),
        (),
        (
            "test_lies_promote_nothing_that_stays",
            "test_a_refit_over_a_bump_of_an_operator_is_refused_or_unharmed",
            "test_a_refit_over_a_moving_reference_is_refused_with_the_reason",
        ),
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
