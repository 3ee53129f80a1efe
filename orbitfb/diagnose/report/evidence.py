"""Section of the page that compares evidence: effects, places, slices of the record."""

from orbitfb.diagnose.report import evidence_pictures
from orbitfb.diagnose.result.diagnosis import Diagnosis
from orbitfb.diagnose.result.quantities import interval
from orbitfb.html.axis import known
from orbitfb.html.page import folded, missing, paragraph, section, table, text

_MOST = 12
"""Effects that are drawn; the table has all."""


def evidence(its: Diagnosis) -> str:
    """Show which effects were tried, and what each explains of the record."""
    said = paragraph(
        "Evidence is counted in nats. It says how much more likely an effect in the model makes "
        "the record: the natural logarithm of the ratio, less a cost for the choice of places and "
        "values. 12 nats are odds of a hundred thousand to one.",
        "note",
    )
    pieces = [said, *_gap(its), *_tournament(its)]
    if its.score_map is not None:
        pieces.append(evidence_pictures.scores(its.score_map))
    pieces += [evidence_pictures.fingerprint(one) for one in its.fingerprints]
    if its.lag_profile is not None and known(its.lag_profile.slope):
        pieces.append(evidence_pictures.lags(its.lag_profile))
    return section("evidence", "The evidence", *pieces)


def _gap(its: Diagnosis) -> list[str]:
    gap = its.gap
    if gap is None or not gap.resolved:
        return []
    whole = interval(gap.nats_per_tick, gap.low, gap.high)
    pieces = [
        paragraph(
            f"The nominal model makes the record less likely than noise alone does, by {whole} "
            f"nats a row. Noise: {text(gap.floor_from)}."
        )
    ]
    if len(its.waterfall) > 1:
        pieces.append(evidence_pictures.waterfall(its.waterfall, its.gap))
    return pieces


def _tournament(its: Diagnosis) -> list[str]:
    if its.tournament is None or not its.tournament.rows:
        return [missing("The comparison of effects")]
    ranked = sorted(its.tournament.rows, key=lambda row: -(row.nats or 0.0))
    rows = [
        (
            f"<b>{text(row.effect)}</b>" if row.accepted else text(row.effect),
            text(row.places),
            "no evidence" if (row.nats or 0.0) <= 0.0 else f"{row.nats:.0f}",
        )
        for row in ranked
    ]
    drawn = [row for row in ranked if (row.nats or 0.0) > 0.0][:_MOST]
    return [
        evidence_pictures.tournament(drawn, its.tournament.free_nats) if drawn else "",
        folded(
            f"all {len(rows)} effects that were tested",
            table(("effect", "best places", "evidence [nats]"), rows),
        ),
    ]
