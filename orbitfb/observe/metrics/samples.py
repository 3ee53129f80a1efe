"""The samples of every metric that is a number or an info, from the figures of one moment."""

import math
import platform
from collections.abc import Iterable, Mapping

from orbitfb import __version__
from orbitfb.core.gap import GapSight
from orbitfb.core.refit import RefitReport
from orbitfb.core.signals import LoopState
from orbitfb.core.status import PostMortemStatus
from orbitfb.effects.registry import all_effects
from orbitfb.history.archive import ArchiveStatus
from orbitfb.observe.metrics.beside import Beside
from orbitfb.observe.statistics.snapshot import LoopSnapshot
from orbitfb.observe.statistics.tallies import kind_of, without_figures

Sample = tuple[tuple[str, ...], float]
"""Values of the labels, and the value."""
Samples = dict[str, Iterable[Sample]]

_PLACES = 5


def samples_of(
    snapshot: LoopSnapshot,
    archive: ArchiveStatus | None,
    postmortems: PostMortemStatus | None,
    beside: Beside,
) -> Samples:
    """Return the samples by name of the metric.

    Args:
        snapshot: Figures of the loop.
        archive: Of the archive, where there is one.
        postmortems: What became of the post-mortems, where they are made.
        beside: Where the rest comes from.
    """
    return {
        **_loop(snapshot, beside),
        **_beam(snapshot, beside),
        **_learning(snapshot, beside),
        **_gap(snapshot.gap),
        **_diagnosis(beside),
        **_service(snapshot, archive, postmortems, beside),
    }


def _loop(snapshot: LoopSnapshot, beside: Beside) -> Samples:
    ticks, closing, state = snapshot.ticks, snapshot.closing, snapshot.state
    reason, believed = kind_of(snapshot.entry_reason), beside.believed()
    return {
        "orbitfb_loop_state": [((one.value,), float(one is state)) for one in LoopState],
        "orbitfb_loop_state_entries_total": [
            ((one.value,), count) for one, count in snapshot.entries.items()
        ],
        "orbitfb_loop_state_duration_seconds": _one(snapshot.in_state),
        "orbitfb_loop_state_reason_info": [((state.value, reason), 1.0)] if state else (),
        "orbitfb_loop_closed_by_info": [((closing.user, closing.host), 1.0)] if closing else (),
        "orbitfb_loop_closed_timestamp_seconds": _one(closing.time) if closing else (),
        "orbitfb_commands_total": [
            ((outcome,), count) for outcome, count in snapshot.commands.items()
        ],
        "orbitfb_ticks_total": _one(ticks.ticks),
        "orbitfb_missed_ticks_total": _one(ticks.missed),
        "orbitfb_held_back_ticks_total": _one(ticks.held_back),
        "orbitfb_answer_asked_ticks_total": _one(believed.asked),
        "orbitfb_answer_silent_total": _one(believed.found),
        "orbitfb_answer_refused_ticks_total": _one(believed.count),
        "orbitfb_limited_ticks_total": _one(snapshot.correctors.limited),
        "orbitfb_last_tick_timestamp_seconds": _one(ticks.time),
        "orbitfb_tick_period_seconds": _one(ticks.period),
        "orbitfb_tick_period_nominal_seconds": _one(beside.period),
        "orbitfb_tick_jitter_seconds": _one(ticks.jitter),
    }


def _beam(snapshot: LoopSnapshot, beside: Beside) -> Samples:
    orbit, correctors, slow = snapshot.orbit, snapshot.correctors, snapshot.auxiliary
    source, noise = snapshot.noise_floor(beside.noise)
    rf = beside.rf()
    return {
        "orbitfb_orbit_rms_meters": [((plane,), rms.now) for plane, rms in orbit.planes.items()],
        "orbitfb_orbit_rms_window_meters": [
            ((plane,), rms.window) for plane, rms in orbit.planes.items()
        ],
        "orbitfb_true_orbit_rms_meters": _one(orbit.true.now),
        "orbitfb_true_orbit_rms_window_meters": _one(orbit.true.window),
        "orbitfb_orbit_error_max_meters": _one(orbit.worst),
        "orbitfb_bpm_noise_meters": [((source,), noise)],
        "orbitfb_bpm_error_rms_meters": [
            ((one.name, one.plane), one.value) for one in orbit.worst_bpms
        ],
        "orbitfb_orbit_timestamp_seconds": _one(orbit.time),
        "orbitfb_bpms": _one(orbit.bpms),
        "orbitfb_bpms_masked": _one(orbit.masked),
        "orbitfb_bpms_invalid": _one(math.nan if math.isnan(orbit.time) else orbit.invalid),
        "orbitfb_bpms_invalid_limit": _one(beside.most_invalid),
        "orbitfb_corrector_setpoint_max_amperes": _one(abs(correctors.setpoint)),
        "orbitfb_corrector_limit_amperes": _one(correctors.limit),
        "orbitfb_corrector_usage_ratio": [
            ((one.name, one.plane), one.value) for one in correctors.nearest
        ],
        "orbitfb_stored_current_amperes": _one(slow.get("current", math.nan)),
        "orbitfb_rf_frequency_hertz": _one(slow.get("rf_frequency", math.nan)),
        "orbitfb_rf_follows": _one(float(rf.following)),
        "orbitfb_rf_steps_total": _one(rf.steps),
        "orbitfb_rf_column_ratio": _one(rf.ratio),
        "orbitfb_corrector_energy_ratio": _one(rf.energy),
    }


def _learning(snapshot: LoopSnapshot, beside: Beside) -> Samples:
    refit, alarm = snapshot.last_refit, snapshot.last_alarm
    policy = snapshot.policy_id
    return {
        "orbitfb_policy_info": [((policy,), 1.0)] if policy else (),
        "orbitfb_policy_swaps_total": _one(snapshot.swaps),
        "orbitfb_refits_total": [
            ((decision.value,), count) for decision, count in snapshot.refits.items()
        ],
        "orbitfb_refit_reasons_total": [
            (labels, count) for labels, count in snapshot.refit_reasons.items()
        ],
        "orbitfb_last_refit_info": [(_verdict(refit), 1.0)] if refit else (),
        "orbitfb_alarms_total": [
            ((cause.value,), count) for cause, count in snapshot.alarms.items()
        ],
        "orbitfb_last_alarm_delay_ticks": _one(alarm.delay) if alarm else (),
        "orbitfb_last_refit_timestamp_seconds": _one(refit.time) if refit else (),
        "orbitfb_last_refit_duration_seconds": _one(refit.duration) if refit else (),
        "orbitfb_last_refit_rows": _one(refit.rows) if refit else (),
        "orbitfb_last_refit_figure": [
            ((name,), figure) for name, figure in (refit.figures.items() if refit else ())
        ],
        "orbitfb_response_change_ratio": _one(_figure(refit, "response_moved")),
        "orbitfb_response_uncertainty_ratio": _one(_figure(refit, "response_uncertainty")),
        "orbitfb_setpoint_change_rms_amperes": _one(snapshot.correctors.change),
        "orbitfb_dither_change_rms_amperes": _one(snapshot.correctors.dither),
        "orbitfb_dither_orbit_cost_meters": _one(beside.dither_cost()),
    }


def _verdict(refit: RefitReport) -> tuple[str, ...]:
    return (
        refit.decision.value,
        refit.stage.value,
        refit.trigger,
        without_figures(refit.reason),
    )


def _figure(refit: RefitReport | None, name: str) -> float:
    return math.nan if refit is None else refit.figures.get(name, math.nan)


def _gap(gap: GapSight | None) -> Samples:
    """Return the samples of the gap; none before the first look."""
    suspected = gap is not None and bool(gap.effect)
    known = all_effects().get(gap.effect) if gap is not None else None
    stage = "unknown" if known is None else known.stage
    return {
        "orbitfb_gap_nats": _one(gap.nats) if gap else (),
        "orbitfb_gap_low_nats": _one(gap.low) if gap else (),
        "orbitfb_gap_high_nats": _one(gap.high) if gap else (),
        "orbitfb_gap_resolved": _one(float(gap.resolved)) if gap else (),
        "orbitfb_gap_suspect_probability": [((gap.effect, stage), gap.probability)]
        if gap and suspected
        else (),
        "orbitfb_gap_suspect_info": [((gap.effect, stage, _places(gap)), 1.0)]
        if gap and suspected
        else (),
        "orbitfb_gap_ticks": _one(gap.ticks) if gap else (),
        "orbitfb_gap_timestamp_seconds": _one(gap.time) if gap else (),
        "orbitfb_gap_duration_seconds": _one(gap.duration) if gap else (),
    }


def _places(gap: GapSight) -> str:
    """Name the devices of a gap; those of the whole ring are not named one by one."""
    if not gap.places:
        return "whole ring"
    more = "" if len(gap.places) <= _PLACES else f" and {len(gap.places) - _PLACES} more"
    return ", ".join(gap.places[:_PLACES]) + more


def _diagnosis(beside: Beside) -> Samples:
    found = beside.diagnosis()
    return {
        "orbitfb_diagnosis_timestamp_seconds": _one(found.time) if found else (),
        "orbitfb_diagnosis_gap_nats": _one(found.nats) if found else (),
        "orbitfb_diagnosis_shrink_ratio": _one(found.shrink) if found else (),
        "orbitfb_diagnosis_shrink_low_ratio": _one(found.low) if found else (),
        "orbitfb_diagnosis_shrink_high_ratio": _one(found.high) if found else (),
    }


def _service(
    snapshot: LoopSnapshot,
    archive: ArchiveStatus | None,
    postmortems: PostMortemStatus | None,
    beside: Beside,
) -> Samples:
    kinds = beside.channels()
    build: Mapping[str, str] = {"version": __version__, "python": platform.python_version()}
    return {
        "orbitfb_archive_rows_written_total": _one(archive.written) if archive else (),
        "orbitfb_archive_rows_dropped_total": _one(archive.dropped) if archive else (),
        "orbitfb_archive_rows_waiting": _one(archive.waiting) if archive else (),
        "orbitfb_archive_failing": _one(float(bool(archive.problem))) if archive else (),
        "orbitfb_clock_steps_total": _one(beside.clock_steps()),
        "orbitfb_settings_unsaved": _one(float(beside.unsaved())),
        "orbitfb_postmortems_written_total": _one(postmortems.written) if postmortems else (),
        "orbitfb_postmortems_failed_total": _one(postmortems.failed) if postmortems else (),
        "orbitfb_channel_access_channels": [((one.kind,), one.channels) for one in kinds],
        "orbitfb_channel_access_channels_connected": [
            ((one.kind,), one.connected) for one in kinds
        ],
        "orbitfb_channel_access_losses_total": [((one.kind,), one.losses) for one in kinds],
        "orbitfb_uptime_seconds": _one(snapshot.duration),
        "orbitfb_build_info": [(tuple(build.values()), 1.0)],
    }


def _one(value: float) -> list[Sample]:
    return [((), value)]
