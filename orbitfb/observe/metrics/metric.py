"""What describes one metric."""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["gauge", "counter", "histogram", "summary", "info"]


@dataclass(frozen=True, slots=True)
class Metric:
    """One metric.

    Args:
        name: Full name as Prometheus shows it, with unit and `_total` or `_info`.
        kind: Its type.
        unit: Base unit; empty for counts and states.
        labels: Names of its labels.
        help: What it is, in one sentence.
    """

    name: str
    kind: Kind
    unit: str
    labels: tuple[str, ...]
    help: str

    @property
    def family(self) -> str:
        """Name of the family, without the suffix that its kind adds."""
        if self.kind == "counter":
            return self.name.removesuffix("_total")
        return self.name.removesuffix("_info") if self.kind == "info" else self.name
