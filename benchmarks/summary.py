"""The few figures that the measurement is about, out of all its runs."""

from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import numpy as np

Row = Mapping[str, Any]
Sections = Mapping[str, Sequence[Row]]
HALF_PERIOD_10HZ_MS = 50.0


def rate_name(rate_hz: float | None) -> str:
    return "lockstep" if rate_hz is None else f"{rate_hz:g} Hz"


def medians(rows: Sequence[Row], value: str = "round_trip_ms") -> dict[tuple[str, str, str], float]:
    """Give the median over the repeats of the p50 of every (rate, server, client) [ms].

    A pair that is missing could not keep up in any repeat: no tick of it was answered.
    """
    found: dict[tuple[str, str, str], list[float]] = {}
    for row in rows:
        if row[value]:
            key = (rate_name(row["rate_hz"]), row["server"], row["client"])
            found.setdefault(key, []).append(row[value]["p50"])
    return {key: median(values) for key, values in found.items()}


def summarise(sections: Sections) -> dict[str, Any]:
    """Compute every headline figure."""
    p50 = medians(sections["runs"])
    rates = list(dict.fromkeys(rate for rate, _, _ in p50))

    def ratio(rate: str, above: tuple[str, str], below: tuple[str, str]) -> float | None:
        over, under = p50.get((rate, *above)), p50.get((rate, *below))
        return None if over is None or under is None else round(over / under, 3)

    def ratios(above: tuple[str, str], below: tuple[str, str]) -> dict[str, float | None]:
        return {rate: ratio(rate, above, below) for rate in rates}

    def counted(name: str, client: str) -> int:
        return sum(row[name] for row in sections["long_runs"] if row["client"] == client)

    return {
        "ratio_plain_over_ours_p50": ratio("lockstep", ("ours", "plain"), ("ours", "service")),
        "missed_at_100hz": counted("missed", "ours"),
        "missed_at_100hz_service": counted("missed", "service"),
        "torn_at_100hz": counted("torn", "ours") + counted("torn", "service"),
        "ratio_ours_ioc_over_base_p50": ratio("lockstep", ("ours", "ours"), ("base", "ours")),
        "ratios": {
            "plain_client_over_service_on_our_ioc": ratios(("ours", "plain"), ("ours", "service")),
            "lean_client_over_service_on_our_ioc": ratios(("ours", "lean"), ("ours", "service")),
            "plain_client_over_our_loop_on_our_ioc": ratios(("ours", "plain"), ("ours", "ours")),
            "plain_client_over_our_loop_on_base": ratios(("base", "plain"), ("base", "ours")),
            "plain_client_on_plain_ioc_over_service_on_our_ioc": ratios(
                ("plain", "plain"), ("ours", "service")
            ),
            "our_ioc_over_base_our_loop": ratios(("ours", "ours"), ("base", "ours")),
            "our_ioc_over_base_plain_client": ratios(("ours", "plain"), ("base", "plain")),
            "arrays_over_scalars_on_our_ioc": ratios(("ours-arrays", "ours"), ("ours", "ours")),
            "arrays_over_scalars_on_base": ratios(("base-arrays", "ours"), ("base", "ours")),
            "pva_arrays_over_scalars_on_our_ioc": ratios(("ours-pva", "ours"), ("ours", "ours")),
            "pva_arrays_over_scalars_on_base": ratios(("base-pva", "ours"), ("base", "ours")),
            "our_ioc_over_plain_ioc_our_loop": ratios(("ours", "ours"), ("plain", "ours")),
        },
        "scaling_fit": {
            server: _line([row for row in sections["scaling"] if row["server"] == server])
            for server in ("ours", "base")
        },
        "added_by": _added(sections["disturbances"]),
    }


def _line(rows: Sequence[Row]) -> dict[str, float]:
    """Fit p50 = fixed + slope · pairs to the medians over the repeats."""
    sizes = sorted({row["size"] for row in rows})
    p50 = [median(r["round_trip_ms"]["p50"] for r in rows if r["size"] == size) for size in sizes]
    slope, fixed = np.polyfit(sizes, p50, 1)
    residual = np.array(p50) - (fixed + slope * np.array(sizes))
    return {
        "us_per_pair": round(float(slope) * 1e3, 3),
        "fixed_ms": round(float(fixed), 4),
        "largest_residual_ms": round(float(np.abs(residual).max()), 4),
        "first_us_per_pair": round(p50[0] / sizes[0] * 1e3, 3),
        "last_us_per_pair": round(p50[-1] / sizes[-1] * 1e3, 3),
    }


def _added(rows: Sequence[Row]) -> dict[str, Any]:
    """Say by how much the worst tick beside a disturbance exceeds the median quiet one."""
    quiet = median(row["latency_ms"]["p50"] for row in rows if row["disturb"] == "nothing")
    return {
        kind: {
            "largest_added_ms": round(
                max(row["latency_ms"]["max"] for row in rows if row["disturb"] == kind) - quiet, 3
            ),
            "missed": sum(row["missed"] for row in rows if row["disturb"] == kind),
            "limit_ms": HALF_PERIOD_10HZ_MS,
        }
        for kind in ("nothing", "swaps", "refits")
    }
