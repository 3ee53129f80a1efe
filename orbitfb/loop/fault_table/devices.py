"""What may happen to BPMs, orbits and correctors: the first rows of the table of faults."""

from orbitfb.core.signals import LoopState
from orbitfb.loop.fault_table.row import Fault

_CLOSED, _HELD, _TRIPPED = LoopState.CLOSED, LoopState.HELD, LoopState.TRIPPED

DEVICE_FAULTS = (
    Fault(
        "a BPM is disconnected, INVALID, NaN or exactly 0, keeps its stamp or repeats its reading "
        "while others change, carries another stamp than they, or jumps alone",
        "left out within the tick (one whose stamp is not that of the others: after one lost "
        "orbit) and named with the reason, the law solved for the rest; counts "
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
            "test_one_bpm_with_another_stamp_costs_one_orbit_is_left_out_and_named",
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
        "setpoint stays, the law solved for the others, the learner does not use its rows; read "
        "again when it is back; counts again when the loop is opened and closed",
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
        "a corrector does not take puts: refused by its server, without write access, or taken "
        "back again and again",
        "refusals are heard, setpoints asked for when readbacks tell otherwise and before the "
        "response is called wrong; left out with its cause, the others take over; what is not as "
        "it was sent for the first time, without a cause, holds the loop as somebody's hand",
        (_CLOSED, _HELD),
        ("interlocks.readback_tolerance", "interlocks.max_lost_correctors"),
        (
            "test_a_corrector_that_does_not_take_puts_is_left_out_and_named",
            "test_a_put_that_the_server_refuses_is_heard_once",
            "test_what_an_operator_moves_once_still_holds_and_names_it",
            "test_a_setpoint_that_was_away_is_not_written_before_it_is_read",
        ),
    ),
    Fault(
        "readings with fresh stamps and noise that do not answer the correctors (blind, repeated, "
        "late), or supplies that echo the setpoint and do not move the beam: of the whole ring",
        "once setpoints have wandered, or no answer was seen for long, the loop asks by small "
        "random excursions and corrects nothing until the ring has answered; TRIPPED if it does "
        "not; such ticks teach nobody",
        (_TRIPPED,),
        ("interlocks.answer_reach", "interlocks.answer_question", "interlocks.answer_after"),
        (
            "test_a_ring_whose_bpms_are_blind_trips_before_the_beam_is_far_away",
            "test_supplies_that_echo_and_do_not_move_trip_and_the_beam_does_not_jump_far",
            "test_orbits_of_the_past_with_fresh_stamps_trip",
            "test_rows_of_a_ring_that_does_not_answer_are_refused",
        ),
    ),
    Fault(
        "the same of a BPM, a corrector or a few of them",
        "left out and named, until the loop is opened; while one of them owes too much of an "
        "answer the loop corrects nothing; more than may be left out hold (BPMs) or trip it",
        (_CLOSED, _HELD, _TRIPPED),
        (
            "interlocks.answer_reach",
            "interlocks.max_invalid_bpms",
            "interlocks.max_lost_correctors",
        ),
        (
            "test_one_blind_bpm_is_left_out_by_name_and_the_loop_goes_on",
            "test_a_corrector_that_the_orbit_does_not_answer_is_left_out_by_name",
            "test_a_cell_of_blind_bpms_does_not_wind_up",
        ),
    ),
    Fault(
        "drive limits of a corrector are narrower than ours, or become so",
        "they hold for that corrector, which leaves the solution when it is there; a setpoint "
        "beyond them is not put, as it would jump",
        (_CLOSED,),
        ("limits.setpoint",),
        (
            "test_drive_limits_narrowed_at_run_time_hold_for_their_corrector",
            "test_one_narrow_supply_shortens_the_change_and_is_named_with_its_limits",
            "test_a_setpoint_beyond_a_drive_limit_is_not_put_as_it_would_jump",
        ),
    ),
    Fault(
        "somebody sets a corrector that is disabled, masked or left out",
        "nothing is put there, so that it stays; when it is given to the loop, that reads its "
        "setpoint first and goes on from there in limited steps",
        (_CLOSED,),
        ("limits.change_per_tick", "interlocks.readback_tolerance"),
        (
            "test_what_an_operator_sets_on_a_disabled_corrector_stays_and_is_gone_on_from",
            "test_on_enabling_it_goes_on_from_there_in_limited_steps",
            "test_the_baseline_that_steps_in_leaves_disabled_correctors_alone",
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
            "test_five_late_changes_in_a_row_do_not_have_each_error_corrected_again_and_again",
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
)
