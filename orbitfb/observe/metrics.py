"""Prometheus metrics: a Collector that reads a snapshot when it is scraped, nothing per tick."""

import dataclasses
import math
import platform
from collections.abc import Callable, Iterable, Iterator, Mapping

from prometheus_client import CollectorRegistry
from prometheus_client.core import (
    CounterMetricFamily,
    GaugeMetricFamily,
    HistogramMetricFamily,
    InfoMetricFamily,
    SummaryMetricFamily,
)
from prometheus_client.metrics_core import Metric as Family
from prometheus_client.registry import Collector

from orbitfb import __version__
from orbitfb.core.gap import GapSight
from orbitfb.core.postmortem import PostMortemStatus
from orbitfb.core.signals import LoopState
from orbitfb.history.archive import ArchiveStatus
from orbitfb.observe.metric import Metric
from orbitfb.observe.metrics_list import METRICS
from orbitfb.observe.snapshot import LoopSnapshot
from orbitfb.observe.windows import LATENCY_BOUNDS

Sample = tuple[tuple[str, ...], float]
"""Values of the labels, and the value."""


class LoopCollector(Collector):
    """Expose the loop's figures to Prometheus.

    Args:
        snapshot: Returns the figures of this moment; called once per scrape.
        archive: Returns the figures of the archive, where there is one.
        postmortems: Returns what became of the post-mortems, where they are made.
    """

    def __init__(
        self,
        snapshot: Callable[[], LoopSnapshot],
        archive: Callable[[], ArchiveStatus] | None = None,
        postmortems: Callable[[], PostMortemStatus] | None = None,
    ) -> None:
        self._snapshot = snapshot
        self._archive = archive
        self._postmortems = postmortems

    def collect(self) -> Iterator[Family]:
        """Yield every family of `METRICS`, in that order."""
        snapshot = self._snapshot()
        archive = None if self._archive is None else self._archive()
        postmortems = None if self._postmortems is None else self._postmortems()
        samples = _samples(snapshot, archive, postmortems)
        for metric in METRICS:
            if metric.kind == "histogram":
                yield _latency(metric, snapshot)
            elif metric.kind == "summary":
                yield _phases(metric, snapshot)
            elif metric.kind == "info":
                yield _info(metric, snapshot)
            else:
                yield _numbers(metric, samples[metric.name])

    def describe(self) -> Iterable[Family]:
        """Return nothing: a registry need not scrape the loop to learn the names."""
        return ()


def metrics_registry(
    snapshot: Callable[[], LoopSnapshot],
    archive: Callable[[], ArchiveStatus] | None = None,
    postmortems: Callable[[], PostMortemStatus] | None = None,
) -> CollectorRegistry:
    """Return a registry that holds the metrics of `METRICS` and no other.

    Args:
        snapshot: As for `LoopCollector`.
        archive: As for `LoopCollector`.
        postmortems: As for `LoopCollector`.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(LoopCollector(snapshot, archive, postmortems))
    return registry


def _samples(
    snapshot: LoopSnapshot, archive: ArchiveStatus | None, postmortems: PostMortemStatus | None
) -> Mapping[str, Iterable[Sample]]:
    """Return the samples of all gauges and counters by name of the metric."""
    orbit, ticks, correctors = snapshot.orbit, snapshot.ticks, snapshot.correctors
    auxiliary, refit = snapshot.auxiliary, snapshot.last_refit
    alarm = snapshot.last_alarm
    return {
        "orbitfb_loop_state": [
            ((state.value,), float(state is snapshot.state)) for state in LoopState
        ],
        "orbitfb_loop_state_entries_total": [
            ((state.value,), count) for state, count in snapshot.entries.items()
        ],
        "orbitfb_loop_state_duration_seconds": _one(snapshot.in_state),
        "orbitfb_ticks_total": _one(ticks.ticks),
        "orbitfb_missed_ticks_total": _one(ticks.missed),
        "orbitfb_limited_ticks_total": _one(correctors.limited),
        "orbitfb_last_tick_timestamp_seconds": _one(ticks.time),
        "orbitfb_tick_period_seconds": _one(ticks.period),
        "orbitfb_tick_jitter_seconds": _one(ticks.jitter),
        "orbitfb_orbit_rms_meters": [((plane,), rms.now) for plane, rms in orbit.planes.items()],
        "orbitfb_orbit_rms_window_meters": [
            ((plane,), rms.window) for plane, rms in orbit.planes.items()
        ],
        "orbitfb_true_orbit_rms_meters": _one(orbit.true.now),
        "orbitfb_true_orbit_rms_window_meters": _one(orbit.true.window),
        "orbitfb_orbit_error_max_meters": _one(orbit.worst),
        "orbitfb_orbit_timestamp_seconds": _one(orbit.time),
        "orbitfb_bpms": _one(orbit.bpms),
        "orbitfb_bpms_masked": _one(orbit.masked),
        "orbitfb_bpms_invalid": _one(math.nan if math.isnan(orbit.time) else orbit.invalid),
        "orbitfb_corrector_setpoint_max_amperes": _one(abs(correctors.setpoint)),
        "orbitfb_corrector_limit_amperes": _one(correctors.limit),
        "orbitfb_stored_current_amperes": _one(auxiliary.get("current", math.nan)),
        "orbitfb_rf_frequency_hertz": _one(auxiliary.get("rf_frequency", math.nan)),
        "orbitfb_policy_swaps_total": _one(snapshot.swaps),
        "orbitfb_refits_total": [
            ((decision.value,), count) for decision, count in snapshot.refits.items()
        ],
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
        **_gap_samples(snapshot.gap),
        "orbitfb_archive_rows_written_total": _one(archive.written) if archive else (),
        "orbitfb_archive_rows_dropped_total": _one(archive.dropped) if archive else (),
        "orbitfb_archive_rows_waiting": _one(archive.waiting) if archive else (),
        "orbitfb_postmortems_written_total": _one(postmortems.written) if postmortems else (),
        "orbitfb_postmortems_failed_total": _one(postmortems.failed) if postmortems else (),
        "orbitfb_uptime_seconds": _one(snapshot.duration),
    }


def _gap_samples(gap: GapSight | None) -> dict[str, Iterable[Sample]]:
    """Return the samples of the gap; none before the first look."""
    suspected = [((gap.effect,), gap.probability)] if gap and gap.effect else []
    return {
        "orbitfb_gap_nats": _one(gap.nats) if gap else (),
        "orbitfb_gap_low_nats": _one(gap.low) if gap else (),
        "orbitfb_gap_high_nats": _one(gap.high) if gap else (),
        "orbitfb_gap_resolved": _one(float(gap.resolved)) if gap else (),
        "orbitfb_gap_suspect_probability": suspected,
        "orbitfb_gap_ticks": _one(gap.ticks) if gap else (),
        "orbitfb_gap_timestamp_seconds": _one(gap.time) if gap else (),
        "orbitfb_gap_duration_seconds": _one(gap.duration) if gap else (),
    }


def _one(value: float) -> list[Sample]:
    return [((), value)]


def _numbers(metric: Metric, samples: Iterable[Sample]) -> Family:
    """Make a gauge or a counter; samples that are NaN, that is unknown, are left out."""
    make = CounterMetricFamily if metric.kind == "counter" else GaugeMetricFamily
    family = make(metric.family, metric.help, labels=metric.labels, unit=metric.unit)
    for labels, value in samples:
        if not math.isnan(value):
            family.add_metric(labels, value)
    return family


def _latency(metric: Metric, snapshot: LoopSnapshot) -> Family:
    bounds = [repr(bound) for bound in LATENCY_BOUNDS] + ["+Inf"]
    family = HistogramMetricFamily(metric.family, metric.help, unit=metric.unit)
    family.add_metric(
        (), list(zip(bounds, snapshot.latency.buckets, strict=True)), snapshot.latency.total
    )
    return family


def _phases(metric: Metric, snapshot: LoopSnapshot) -> Family:
    family = SummaryMetricFamily(metric.family, metric.help, labels=metric.labels, unit=metric.unit)
    for phase in dataclasses.fields(snapshot.ticks.phases):
        total = getattr(snapshot.ticks.phases, phase.name)
        family.add_metric((phase.name,), snapshot.ticks.ticks, total)
    return family


def _info(metric: Metric, snapshot: LoopSnapshot) -> Family:
    values = {
        "orbitfb_policy_info": {"policy": snapshot.policy_id},
        "orbitfb_build_info": {"version": __version__, "python": platform.python_version()},
    }[metric.name]
    family = InfoMetricFamily(metric.family, metric.help)
    if all(values.values()):
        family.add_metric((), values)
    return family
