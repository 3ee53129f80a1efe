"""The table of metrics, the scrape and the page of the docs say the same."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from observe_records import channels, feed, record, report
from prometheus_client.exposition import choose_encoder
from prometheus_client.openmetrics.parser import text_string_to_metric_families as open_families
from prometheus_client.parser import text_string_to_metric_families

from orbitfb.core.gap import GapSight
from orbitfb.core.refit import Alarm, AlarmCause, Decision
from orbitfb.core.signals import LoopState
from orbitfb.core.status import ChannelCounts, PostMortemStatus
from orbitfb.history.archive import ArchiveStatus
from orbitfb.loop.frequency import Sight
from orbitfb.observe.last_diagnosis import DiagnosisFigures, LastDiagnosis
from orbitfb.observe.metrics.beside import Beside
from orbitfb.observe.metrics.catalogue import METRICS
from orbitfb.observe.metrics.collector import metrics_registry
from orbitfb.observe.metrics.reference import metrics_table_markdown
from orbitfb.observe.statistics.running import LoopStatistics
from orbitfb.safety.believed import Believed

PAGE = Path(__file__).parents[3] / "docs/reference/metrics.md"


@pytest.fixture
def full(statistics, clock):
    """Statistics in which every figure is known."""
    feed(
        statistics,
        clock,
        20,
        error=(2e-6, -2e-6, 2e-6, -2e-6),
        true=1e-7,
        latency=1.5e-3,
        auxiliary={"current": 0.4, "rf_frequency": 499.68e6},
        reason="good again",
    )
    statistics.refitted(
        report(
            Decision.PROMOTED,
            model_change=0.1,
            reading_noise=2e-7,
            response_moved=0.02,
            response_uncertainty=0.01,
        )
    )
    statistics.commanded("close", "jane", "10.0.5.9")
    statistics.alarmed(Alarm(20, AlarmCause.DRIFT, 7.0, 20.0, 15.0))
    statistics.gap_seen(GapSight(1.7e9, 600, 0.3, 0.2, 0.4, True, "bpm-gain", probability=0.98))
    return statistics


def everything_beside():
    return Beside(
        channels=lambda: (ChannelCounts("bpm", 180, 179, 1),),
        dither_cost=lambda: 1e-7,
        diagnosis=lambda: DiagnosisFigures(1.7e9, 9.3, 0.99, 0.9, 1.0),
        period=0.1,
        noise=1e-7,
        most_invalid=9,
        rf=lambda: Sight(True, "", 5e8, 1e-6, 3, 0.2, 1.08),
    )


def test_what_was_asked_and_not_answered_is_counted(full):
    beside = Beside(believed=lambda: Believed(asked=7, found=2, count=300))
    _, values = scrape(full, beside=beside)
    assert values["orbitfb_answer_asked_ticks_total", ()] == 7
    assert values["orbitfb_answer_silent_total", ()] == 2
    assert values["orbitfb_answer_refused_ticks_total", ()] == 300


def scrape(statistics, archive=None, postmortems=None, beside=None):
    encode, _ = choose_encoder("text/plain")
    text = encode(metrics_registry(statistics.snapshot, archive, postmortems, beside)).decode()
    families = list(text_string_to_metric_families(text))
    values = {
        (sample.name, tuple(sorted(sample.labels.items()))): sample.value
        for family in families
        for sample in family.samples
    }
    return families, values


def archive():
    return ArchiveStatus(written=120, dropped=3, waiting=7, segment=None, problem="disk full")


def postmortems():
    return PostMortemStatus(written=2, failed=1, waiting=0, last="", problem="")


def test_a_scrape_exposes_exactly_the_table(full):
    families, _ = scrape(full, archive, postmortems, everything_beside())
    exposed = {
        f"{family.name}_total" if family.type == "counter" else family.name: family
        for family in families
    }
    assert set(exposed) == {metric.name for metric in METRICS}
    for metric in METRICS:
        family = exposed[metric.name]
        assert family.documentation == metric.help
        assert family.type == {"info": "gauge"}.get(metric.kind, metric.kind)
        assert family.samples, f"{metric.name} has no sample though all is known"
        for sample in family.samples:
            assert set(sample.labels) - {"le"} == set(metric.labels), sample


def test_names_carry_their_unit_and_nothing_is_listed_twice():
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    for metric in METRICS:
        assert metric.name.startswith("orbitfb_")
        assert metric.name.endswith(metric.unit)
        assert metric.name.endswith("_total") == (metric.kind == "counter")
        assert metric.name.endswith("_info") == (metric.kind == "info")


def test_the_page_of_the_docs_is_the_table():
    assert PAGE.read_text(encoding="utf-8") == metrics_table_markdown(), (
        "run: python -m orbitfb.observe.metrics.reference > docs/reference/metrics.md"
    )


def test_values_are_those_of_the_loop(full):
    _, values = scrape(full, archive)
    assert values["orbitfb_ticks_total", ()] == 20
    assert values["orbitfb_orbit_rms_meters", (("plane", "x"),)] == pytest.approx(2e-6)
    assert values["orbitfb_true_orbit_rms_meters", ()] == pytest.approx(1e-7)
    assert values["orbitfb_loop_state", (("state", "CLOSED"),)] == 1
    assert values["orbitfb_loop_state", (("state", "HELD"),)] == 0
    assert values["orbitfb_tick_latency_seconds_bucket", (("le", "0.001"),)] == 0
    assert values["orbitfb_tick_latency_seconds_bucket", (("le", "0.002"),)] == 20
    assert values["orbitfb_tick_latency_seconds_count", ()] == 20
    assert values["orbitfb_tick_latency_seconds_sum", ()] == pytest.approx(0.03)
    assert values["orbitfb_tick_phase_seconds_sum", (("phase", "act"),)] == pytest.approx(0.02)
    assert values["orbitfb_tick_phase_seconds_count", (("phase", "act"),)] == 20
    assert values["orbitfb_refits_total", (("decision", "promoted"),)] == 1
    assert values["orbitfb_last_refit_figure", (("figure", "model_change"),)] == 0.1
    assert values["orbitfb_policy_info", (("policy", "svd-1"),)] == 1
    assert values["orbitfb_archive_rows_dropped_total", ()] == 3
    assert values["orbitfb_archive_rows_waiting", ()] == 7
    assert values["orbitfb_corrector_setpoint_max_amperes", ()] == 2.0
    assert values["orbitfb_stored_current_amperes", ()] == 0.4


def test_what_is_unknown_is_left_out_and_never_nan(statistics):
    _, values = scrape(statistics)
    names = {name for name, _ in values}
    assert "orbitfb_orbit_rms_meters" not in names
    assert "orbitfb_bpms_invalid" not in names
    assert "orbitfb_archive_rows_written_total" not in names
    assert not any(math.isnan(value) for value in values.values())
    states = [value for (name, _), value in values.items() if name == "orbitfb_loop_state"]
    assert states == [0.0] * len(LoopState)


def test_a_lost_orbit_takes_its_figures_out_of_the_scrape(full):
    full(record(21, lost=True, state=LoopState.HELD, missed=1))
    _, values = scrape(full)
    assert ("orbitfb_orbit_rms_meters", (("plane", "x"),)) not in values
    assert ("orbitfb_orbit_rms_window_meters", (("plane", "x"),)) in values
    assert values["orbitfb_missed_ticks_total", ()] == 1


def test_ticks_that_are_held_back_are_counted(full):
    full(record(21, held_back=True))
    full(record(22))
    _, values = scrape(full)
    assert values["orbitfb_held_back_ticks_total", ()] == 1


def test_strict_openmetrics_readers_take_it_too(full):
    encode, content_type = choose_encoder("application/openmetrics-text; version=1.0.0")
    assert content_type.startswith("application/openmetrics-text")
    text = encode(metrics_registry(full.snapshot, archive)).decode()
    assert {family.name for family in open_families(text)} == {metric.family for metric in METRICS}


def test_the_gap_is_told_with_its_suspect_and_not_before_the_first_look(statistics, clock):
    families, _ = scrape(statistics, archive)
    assert not next(f for f in families if f.name == "orbitfb_gap_nats").samples
    statistics.gap_seen(GapSight(1.7e9, 600, 0.3, 0.2, 0.4, True, "bpm-gain", probability=0.98))
    families, _ = scrape(statistics, archive)
    values = {f.name: f.samples for f in families}
    assert values["orbitfb_gap_nats"][0].value == 0.3
    assert values["orbitfb_gap_resolved"][0].value == 1.0
    (suspect,) = values["orbitfb_gap_suspect_probability"]
    assert (suspect.labels, suspect.value) == (
        {"effect": "bpm-gain", "stage": "sensor"},
        0.98,
    )
    assert [h.kind for h in statistics.snapshot().happenings] == ["gap"]


def test_masked_and_invalid_bpms_are_counted_apart(clock):
    statistics = LoopStatistics(channels(), 18.0, clock, np.array([True, False, True, True]))
    statistics(record(valid=(True, False, False, True)))
    _, values = scrape(statistics)
    assert values["orbitfb_bpms_masked", ()] == values["orbitfb_bpms_invalid", ()] == 1
    assert values["orbitfb_bpms", ()] == 4


def test_what_lies_beside_the_loop_is_told(full):
    _, values = scrape(full, archive, None, everything_beside())
    assert values["orbitfb_tick_period_nominal_seconds", ()] == 0.1
    assert values["orbitfb_bpms_invalid_limit", ()] == 9
    assert values["orbitfb_dither_orbit_cost_meters", ()] == 1e-7
    assert values["orbitfb_archive_failing", ()] == 1
    kind = (("kind", "bpm"),)
    assert values["orbitfb_channel_access_channels", kind] == 180
    assert values["orbitfb_channel_access_channels_connected", kind] == 179
    assert values["orbitfb_channel_access_losses_total", kind] == 1
    assert values["orbitfb_diagnosis_shrink_ratio", ()] == 0.99


def test_the_noise_floor_is_what_the_refit_found_and_before_it_what_is_believed(statistics):
    floor = "orbitfb_bpm_noise_meters"
    _, values = scrape(statistics, beside=everything_beside())
    assert values[floor, (("source", "configuration"),)] == 1e-7
    statistics.refitted(report(reading_noise=2e-7))
    statistics.refitted(report())  # one that failed and found nothing
    _, values = scrape(statistics, beside=everything_beside())
    assert {key: value for key, value in values.items() if key[0] == floor} == {
        (floor, (("source", "refit"),)): 2e-7
    }


def test_the_worst_bpms_and_nearest_correctors_are_named_with_their_plane(clock):
    statistics = LoopStatistics(channels("xy", 12, 4), 10.0, clock)
    error = np.full(12, 1e-6)
    error[[2, 7]] = 5e-6, -9e-6
    feed(statistics, clock, 3, error=error, setpoints=(1, 2, -8, 0), applied=(0, 0, -1, 0))
    _, values = scrape(statistics)
    worst = {key[1]: value for key, value in values.items() if "bpm_error" in key[0]}
    assert len(worst) == 5
    assert worst[("bpm", "BPM7"), ("plane", "y")] == pytest.approx(9e-6)
    assert worst[("bpm", "BPM2"), ("plane", "x")] == pytest.approx(5e-6)
    usage = {key[1]: value for key, value in values.items() if "usage" in key[0]}
    assert usage[("corrector", "COR2"), ("plane", "y")] == pytest.approx(0.9)
    assert values["orbitfb_setpoint_change_rms_amperes", ()] == pytest.approx(0.5)


def test_an_invalid_bpm_is_not_among_the_worst(clock):
    statistics = LoopStatistics(channels(), 18.0, clock)
    feed(statistics, clock, 3, error=(9e-6, 1e-6, 1e-6, 1e-6))
    feed(statistics, clock, 1, error=(0, 1e-6, 1e-6, 1e-6), valid=(False, True, True, True))
    names = [one.name for one in statistics.snapshot().orbit.worst_bpms]
    assert sorted(names) == ["BPM1", "BPM2", "BPM3"]


def test_who_closed_the_loop_is_told(statistics, clock):
    statistics(record())
    assert statistics.snapshot().closing.user == "start"
    statistics.commanded("close", "eve", "10.0.0.1", "the beam is gone")
    statistics.commanded("close", "jane", "10.0.5.9")
    statistics.commanded("gain", "joe", "localhost")
    _, values = scrape(statistics)
    assert values["orbitfb_loop_closed_by_info", (("host", "10.0.5.9"), ("user", "jane"))] == 1
    assert values["orbitfb_commands_total", (("outcome", "given"),)] == 2
    assert values["orbitfb_commands_total", (("outcome", "refused"),)] == 1
    clock.advance(30.0)
    statistics.commanded("close", "late", "10.0.5.8")  # it was closed already
    assert statistics.snapshot().closing.user == "jane"


def test_refusals_are_counted_by_reason_without_its_figures(statistics):
    for gain in (0.3, 1.7):
        text = f"expected beam motion {gain:.4f} µm rms, now 0.1 µm rms: the gain is below 0.2 %"
        statistics.refitted(dataclasses.replace(report(), reason=text))
    for number in range(60):
        statistics.refitted(dataclasses.replace(report(), reason="x" * number))
    counts = statistics.snapshot().refit_reasons
    reason = "expected beam motion … rms, now … rms: the gain is below …"
    assert counts["refused", "judge", reason] == 2
    assert counts["refused", "judge", "other"] == 60 - 39
    assert len(counts) == 41


def test_a_diagnosis_is_read_when_it_changes_and_a_damaged_one_is_left_out(tmp_path):
    last = LastDiagnosis(tmp_path)
    assert last() is None
    file = tmp_path / "archive.diagnosis/diagnosis.json"
    file.parent.mkdir()
    file.write_text('{"gap": {"nats_per_tick": 9.3}, "shrink": {"nats": 0.99, "low": 0.9}}')
    figures = last()
    assert (figures.nats, figures.shrink, figures.low) == (9.3, 0.99, 0.9)
    assert math.isnan(figures.high)
    for damaged in ("{", "[]", '{"gap": 3, "shrink": {"nats": "much"}}'):
        file.write_text(damaged)
        figures = last()
        assert figures is None or math.isnan(figures.shrink)
