"""The table of faults, as data: what may happen, what the loop answers, by which rule and test.

The page on safety is written from it, and a test looks every setting and every test up.
"""

from orbitfb.core.signals import LoopState
from orbitfb.loop.fault_table.devices import DEVICE_FAULTS
from orbitfb.loop.fault_table.fast_feedback import FAST_FEEDBACK_FAULTS
from orbitfb.loop.fault_table.row import Fault

_OPEN, _CLOSED, _HELD, _TRIPPED = (
    LoopState.OPEN,
    LoopState.CLOSED,
    LoopState.HELD,
    LoopState.TRIPPED,
)


FAULTS = (
    *DEVICE_FAULTS,
    Fault(
        "the policy fails, or its change is not finite or has the wrong shape",
        "The SVD baseline decides from this tick on, until another policy is put in force or the "
        "loop is closed again. A value that is not finite is never sent.",
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
        "the policy decides too late, or it takes too long to learn and decide",
        "If it decides too late, the baseline decides at this tick. After three late ticks in a "
        "row the baseline keeps deciding.",
        (_CLOSED,),
        ("loop.policy_deadline",),
        (
            "test_a_slow_policy_is_put_aside_after_three_strikes",
            "test_a_policy_that_learns_too_long_is_put_aside_after_three_ticks",
        ),
    ),
    Fault(
        "the computer is slower than the orbits: the next orbit comes before the change for the "
        "last one has left",
        "Such an orbit does not know of the change. It is passed over and counted as missed, so "
        "that no error is corrected twice.",
        (_CLOSED,),
        (),
        ("test_an_orbit_that_came_before_the_last_change_left_is_passed_over",),
    ),
    Fault(
        "PVs come from another server than before, such as a test IOC with the same names",
        "Nothing is written. Another server is another machine, so HELD does not end by itself: "
        "an operator closes the loop. PVs that two servers have are named at the start.",
        (_HELD,),
        ("epics.address_list", "epics.name_servers"),
        (
            "test_a_move_while_closed_holds_until_an_operator_closes",
            "test_a_move_during_an_outage_keeps_the_loop_from_closing_by_itself",
            "test_what_libca_says_of_doubled_pvs_is_put_into_words",
        ),
    ),
    Fault(
        "the stored current is too low, drops, is not known or old",
        "The loop trips in the same tick, setpoints stay, and a post-mortem is written. A drop "
        "also trips a HELD loop. A stamp in the future counts from when it was first seen; one "
        "further ahead than the current may be old tells nothing.",
        (_TRIPPED,),
        (
            "interlocks.current_min",
            "interlocks.current_drop",
            "epics.auxiliary",
        ),
        (
            "test_the_stored_current_trips",
            "test_a_stored_current_that_drops_while_held_trips",
            "test_a_value_stamped_in_the_future_grows_old_from_when_it_was_seen",
        ),
    ),
    *FAST_FEEDBACK_FAULTS,
    Fault(
        "the orbit error is too large (rms, largest) or grows too fast",
        "The loop trips. Setpoints stay; or, if so configured, they return to the last good ones "
        "in limited steps, which stop as soon as anything is wrong.",
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
        "The loop trips after a few ticks: the orbit does not respond as predicted and does not "
        "get better, or it grows from tick to tick.",
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
        "Nothing is written until they are read again.",
        (_HELD, _TRIPPED),
        ("loop.trip_after",),
        (
            "test_an_operator_who_moves_a_corrector_is_not_fought",
            "test_a_failed_write_holds_and_what_is_in_force_is_asked_for",
        ),
    ),
    Fault(
        "the IOC or the network is gone and comes back",
        "Nothing is written in the meantime. Setpoints and drive limits are read again before "
        "the loop closes; drive limits that are narrower now hold for their corrector.",
        (_HELD, _TRIPPED),
        ("loop.proving", "loop.reclose", "loop.trip_after", "limits.setpoint"),
        (
            "test_killed_ioc_holds_the_loop_until_it_is_back",
            "test_the_limits_of_a_server_that_comes_back_with_narrower_ones_hold",
        ),
    ),
    Fault(
        "the disk is full, the directory of archive or log is gone",
        "The loop goes on and says so. Ticks and log lines wait until there is room. If too many "
        "wait, the newest ticks are dropped and counted.",
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
        "The loop goes on and says so; if the time stamps went back, a few orbits are lost "
        "first. All rules use a clock that cannot be set.",
        (_CLOSED,),
        (),
        (
            "test_our_clock_is_set_and_the_loop_goes_on",
            "test_both_clocks_are_set_and_the_loop_goes_on",
            "test_a_clock_that_was_set_is_told_and_counted",
        ),
    ),
    Fault(
        "only the clock of the IOC is set, by more than the largest age of an orbit",
        "Nothing is written until it is right again: its orbits might be old.",
        (_HELD, _TRIPPED),
        ("epics.stale_after", "loop.trip_after"),
        ("test_the_clock_of_the_ioc_is_set_and_the_loop_goes_on_once_it_is_right",),
    ),
    Fault(
        "a refit is poisoned: bad rows, no excitation, an operator's bump, another reference",
        "Such rows are left out and counted by reason. If too few are left, the refit is refused "
        "with the reason. A policy that makes the loop worse is rolled back automatically.",
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
        "Setpoints stay. The next start begins OPEN, or closes if so configured.",
        (_OPEN,),
        (),
        (
            "test_setpoints_stay_when_the_controller_is_killed",
            "test_restart_closes_by_itself_without_a_bump_if_so_told",
        ),
    ),
    Fault(
        "another controller writes",
        "The second controller refuses to start. A lost lease opens the loop.",
        (_OPEN,),
        ("lease.pv", "lease.time"),
        ("test_one_of_two_controllers_writes_and_a_stale_lease_is_taken_over",),
    ),
    Fault(
        "another controller writes, and there is no lease",
        "The command close is refused, and a loop that waits to close trips. If two loops closed "
        "at once, one trips and says which setpoints the other moves.",
        (_TRIPPED,),
        ("interlocks.second_controller_ticks",),
        (
            "test_of_two_that_close_at_once_one_opens_and_says_why",
            "test_one_that_comes_later_does_not_close",
            "test_the_machine_hears_its_setpoints",
            "test_two_controllers_without_a_lease_see_each_other",
        ),
    ),
    Fault(
        "an unexpected error",
        "Setpoints stay. Start the program again.",
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
