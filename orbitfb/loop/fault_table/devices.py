"""What may happen to BPMs, orbits and correctors: the first rows of the table of faults."""

from orbitfb.core.signals import LoopState
from orbitfb.loop.fault_table.row import Fault

_CLOSED, _HELD, _TRIPPED = LoopState.CLOSED, LoopState.HELD, LoopState.TRIPPED

DEVICE_FAULTS = (
    Fault(
        "a BPM is disconnected, INVALID, NaN or exactly 0; it repeats its time stamp or its "
        "reading while others change; its time stamp is not that of the others; or it jumps alone",
        "The BPM is left out in the same tick and named with the reason; the policy acts on the "
        "others. If its time stamp is not that of the others, one orbit is lost first. It counts "
        "again after several good readings in a row. A BPM that jumped counts again when it "
        "reads its former value, or after the loop was opened.",
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
        "more such BPMs than allowed, or too many next to each other; BPMs of `masks.bpms` and "
        "disabled ones do not count",
        "Nothing is written until they are back.",
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
        "Nothing is written. The loop never acts on an old orbit.",
        (_HELD, _TRIPPED),
        ("loop.hold_after", "interlocks.frozen_ticks", "epics.stale_after", "loop.trip_after"),
        (
            "test_a_frozen_orbit_is_not_integrated",
            "test_a_frozen_ioc_is_noticed_too",
            "test_a_torn_orbit_is_refused_and_the_late_bpm_named",
        ),
    ),
    Fault(
        "a corrector is off, stuck or disconnected, or its readback is missing or beyond the "
        "tolerance",
        "The corrector is left out after some ticks, at once if its setpoint cannot be written, "
        "and named. Its setpoint stays, the policy uses the others, and the learner leaves out "
        "its rows. When it is back, its setpoint is read again. It moves again after the loop "
        "was opened and closed.",
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
        "a corrector does not accept puts: its server refuses them, write access is missing, or "
        "the setpoint returns to its old value again and again",
        "The loop notices refusals. It asks for the setpoints if readbacks differ from them, and "
        "before it calls the response wrong. The corrector is left out with the cause, and the "
        "others take over. A setpoint that differs for the first time, without a known cause, "
        "counts as moved by somebody and holds the loop.",
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
        "the whole ring does not respond: readings have new time stamps and noise, but do not "
        "follow the correctors (blind, repeated, late), or power supplies repeat the setpoint "
        "and do not move the beam",
        "If the setpoints have moved far, or no response was seen for long, the loop makes small "
        "random excursions and corrects nothing until the ring has answered. If it does not "
        "answer, the loop trips. The learner does not use such ticks.",
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
        "one BPM or corrector, or a few of them, do not respond",
        "They are left out and named until the loop is opened. While it is not yet certain, the "
        "loop corrects nothing. More BPMs than may be left out hold the loop; more correctors "
        "trip it.",
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
        "the drive limits of a corrector are narrower than those of the configuration, or become "
        "so",
        "The narrower limits hold for this corrector. At its limit the others take over. A "
        "setpoint beyond the limits is not sent, because it would jump.",
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
        "The loop sends nothing to it. When the corrector is enabled, the loop first reads its "
        "setpoint, and continues from there in limited steps.",
        (_CLOSED,),
        ("limits.change_per_tick", "interlocks.readback_tolerance"),
        (
            "test_what_an_operator_sets_on_a_disabled_corrector_stays_and_is_gone_on_from",
            "test_on_enabling_it_goes_on_from_there_in_limited_steps",
            "test_the_baseline_that_steps_in_leaves_disabled_correctors_alone",
        ),
    ),
    Fault(
        "a change that was sent does not show in the readbacks of the next orbit, as it usually "
        "does: puts or orbits are late",
        "This tick writes nothing and is counted, so that no error is corrected twice. After as "
        "many ticks as readbacks may lag, the setpoints are read again before the loop goes on.",
        (_CLOSED,),
        ("interlocks.readback_lag",),
        (
            "test_one_error_is_corrected_once_while_puts_are_late",
            "test_a_change_that_was_lost_is_found_out_by_asking",
            "test_five_late_changes_in_a_row_do_not_have_each_error_corrected_again_and_again",
        ),
    ),
    Fault(
        "more lost correctors than allowed",
        "The loop trips. While a readback is missing it is HELD, because the IOC may come back, "
        "and until the readback has had its ticks to follow.",
        (_HELD, _TRIPPED),
        ("interlocks.max_lost_correctors", "interlocks.readback_ticks"),
        (
            "test_more_correctors_than_may_be_lost_trip",
            "test_readbacks_that_come_back_in_waves_with_what_they_said_before_only_hold",
        ),
    ),
    Fault(
        "a corrector would go beyond its limit",
        "At its limit the others take over in the same tick. The corrector is named; a warning "
        "comes before.",
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
        "The whole change is scaled down; its direction stays.",
        (_CLOSED,),
        ("limits.change_per_tick",),
        ("test_limits_hold_for_any_finite_input",),
    ),
)
