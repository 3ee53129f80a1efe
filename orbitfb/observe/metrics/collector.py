"""Prometheus metrics: a Collector that reads a snapshot when it is scraped, nothing per tick."""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator

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

from orbitfb.core.status import PostMortemStatus
from orbitfb.history.archive import ArchiveStatus
from orbitfb.observe.metrics.beside import Beside
from orbitfb.observe.metrics.catalogue import METRICS
from orbitfb.observe.metrics.metric import Metric
from orbitfb.observe.metrics.samples import Sample, samples_of
from orbitfb.observe.statistics.snapshot import LoopSnapshot
from orbitfb.observe.statistics.windows import LATENCY_BOUNDS


class LoopCollector(Collector):
    """Expose the loop's figures to Prometheus.

    Args:
        snapshot: Returns the figures of this moment; called once per scrape.
        archive: Returns the figures of the archive, where there is one.
        postmortems: Returns what became of the post-mortems, where they are made.
        beside: Where the rest comes from.
    """

    def __init__(
        self,
        snapshot: Callable[[], LoopSnapshot],
        archive: Callable[[], ArchiveStatus] | None = None,
        postmortems: Callable[[], PostMortemStatus] | None = None,
        beside: Beside | None = None,
    ) -> None:
        self._snapshot = snapshot
        self._archive = archive
        self._postmortems = postmortems
        self._beside = beside or Beside()

    def collect(self) -> Iterator[Family]:
        """Yield every family of `METRICS`, in that order."""
        snapshot = self._snapshot()
        archive = None if self._archive is None else self._archive()
        postmortems = None if self._postmortems is None else self._postmortems()
        samples = samples_of(snapshot, archive, postmortems, self._beside)
        for metric in METRICS:
            if metric.kind == "histogram":
                yield _latency(metric, snapshot)
            elif metric.kind == "summary":
                yield _phases(metric, snapshot)
            elif metric.kind == "info":
                yield _info(metric, samples[metric.name])
            else:
                yield _numbers(metric, samples[metric.name])

    def describe(self) -> Iterable[Family]:
        """Return nothing: a registry need not scrape the loop to learn the names."""
        return ()


def metrics_registry(
    snapshot: Callable[[], LoopSnapshot],
    archive: Callable[[], ArchiveStatus] | None = None,
    postmortems: Callable[[], PostMortemStatus] | None = None,
    beside: Beside | None = None,
) -> CollectorRegistry:
    """Return a registry that holds the metrics of `METRICS` and no other.

    Args:
        snapshot: As for `LoopCollector`.
        archive: As for `LoopCollector`.
        postmortems: As for `LoopCollector`.
        beside: As for `LoopCollector`.
    """
    registry = CollectorRegistry(auto_describe=False)
    registry.register(LoopCollector(snapshot, archive, postmortems, beside))
    return registry


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


def _info(metric: Metric, samples: Iterable[Sample]) -> Family:
    family = InfoMetricFamily(metric.family, metric.help)
    for labels, _ in samples:
        family.add_metric((), dict(zip(metric.labels, labels, strict=True)))
    return family
