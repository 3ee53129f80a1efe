"""Pictures drawn straight into the page: they take its colours, light or dark, and its letters.

A picture is one or more panels beside or below each other; a panel has two axes and marks. All
coordinates are those of the data; what is not a number is not drawn.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from orbitfb.core.signals import Vector
from orbitfb.html.axis import Axis, Numbers, values
from orbitfb.html.page import text

BLUE, RED, GREEN, ORANGE = "var(--blue)", "var(--bad)", "var(--good)", "var(--doubt)"
PURPLE, GREY, INK = "var(--odd)", "var(--soft)", "var(--ink)"
"""Colours of the page, which it has for light and for dark."""

STAGES = {
    "sensor": BLUE,
    "actuator": RED,
    "optics": GREEN,
    "disturbance": ORANGE,
    "noise": PURPLE,
    "timing": BLUE,
}
"""Colour of every stage."""

WIDTH = 640
"""Width of a picture; its letters are 12 of these high."""


@dataclass(slots=True)
class Panel:
    """Two axes and what is drawn between them.

    Args:
        x: Horizontal axis.
        y: Vertical axis.
        height: Of the drawing.
        title: Above it.
        left: Room for the words beside the vertical axis.
        share: Of the width of the picture [1].
    """

    x: Axis
    y: Axis
    height: int = 150
    title: str = ""
    left: int = 58
    share: float = 1.0
    _marks: list[str] = field(default_factory=list)
    _legend: list[tuple[str, str, bool]] = field(default_factory=list)

    @property
    def _width(self) -> float:
        return WIDTH * self.share - self.left - 14

    def _at(self, x: float, y: float) -> tuple[float, float]:
        return self.left + self.x.share(x) * self._width, (1.0 - self.y.share(y)) * self.height

    def bars(self, lefts: Numbers, rights: Numbers, heights: Numbers, colour: str) -> None:
        """Bars from zero, between their edges."""
        floor = max(self.y.low, 0.0) if not self.y.log else self.y.low
        for left, right, height in zip(values(lefts), values(rights), values(heights), strict=True):
            if np.isfinite(height):
                x0, y0 = self._at(left, max(height, floor))
                x1, y1 = self._at(right, min(height, floor))
                self._box(x0, y0, x1, y1, colour)

    def lying(self, heights: Numbers, colours: Sequence[str], words: Sequence[str]) -> None:
        """Bars that lie, one below the other, with words at their ends."""
        for place, (length, colour, word) in enumerate(
            zip(values(heights), colours, words, strict=True)
        ):
            if np.isfinite(length):
                x0, y0 = self._at(0.0, place - 0.35)
                x1, y1 = self._at(max(length, 0.0), place + 0.35)
                self._box(x0, min(y0, y1), x1, max(y0, y1), colour)
                self.word(max(length, 0.0), place, word)

    def _box(self, x0: float, y0: float, x1: float, y1: float, colour: str) -> None:
        self._marks.append(
            f'<rect x="{x0:.1f}" y="{y0:.1f}" width="{max(x1 - x0 - 0.6, 0.6):.1f}" '
            f'height="{max(y1 - y0, 0.4):.1f}" fill="{colour}"/>'
        )

    def word(self, x: float, y: float, content: str) -> None:
        """Text behind a point."""
        px, py = self._at(x, y)
        self._marks.append(
            f'<text x="{px + 4:.1f}" y="{py + 4:.1f}" fill="{INK}">{text(content)}</text>'
        )

    def line(
        self, x: Numbers, y: Numbers, colour: str, label: str = "", dashed: bool = False
    ) -> None:
        """A line through points; broken where one is not known."""
        points = [
            self._at(a, b)
            for a, b in zip(values(x), values(y), strict=True)
            if np.isfinite(b) and (b > 0.0 or not self.y.log)
        ]
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        path = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
        self._marks.append(
            f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="1.6"{dash}/>'
        )
        if label:
            self._legend.append((label, colour, dashed))

    def stems(self, x: Numbers, y: Numbers, colour: str, label: str = "") -> None:
        """Lines from zero up to points."""
        for a, b in zip(values(x), values(y), strict=True):
            if np.isfinite(a) and np.isfinite(b):
                px, py = self._at(a, b)
                foot = self._at(a, max(self.y.low, 0.0))[1]
                self._marks.append(
                    f'<path d="M{px:.1f} {foot:.1f}V{py:.1f}" stroke="{colour}"/>'
                    f'<circle cx="{px:.1f}" cy="{py:.1f}" r="1.6" fill="{colour}"/>'
                )
        if label:
            self._legend.append((label, colour, False))

    def dots(
        self, x: Numbers, y: Numbers, colour: str, label: str = "",
        ends: tuple[Numbers, Numbers] | None = None,
    ) -> None:  # fmt: skip
        """Points, with bars between their ends."""
        for a, b in zip(values(x), values(y), strict=True):
            if np.isfinite(a) and np.isfinite(b):
                px, py = self._at(a, b)
                self._marks.append(f'<circle cx="{px:.1f}" cy="{py:.1f}" r="3" fill="{colour}"/>')
        if ends is not None:
            for a, low, high in zip(values(x), values(ends[0]), values(ends[1]), strict=True):
                if np.isfinite(low) and np.isfinite(high):
                    px, py = self._at(a, low)
                    top = self._at(a, high)[1]
                    self._marks.append(
                        f'<path d="M{px:.1f} {py:.1f}V{top:.1f}" stroke="{colour}"/>'
                    )
        if label:
            self._legend.append((label, colour, False))

    def level(self, y: float, dashed: bool = True, colour: str = GREY) -> None:
        """A line over the whole width."""
        self.line([self.x.low, self.x.high], [y, y], colour, dashed=dashed)

    def moment(self, x: float, colour: str = RED, label: str = "") -> None:
        """A line over the whole height."""
        self.line([x, x], [self.y.low, self.y.high], colour, label, dashed=True)

    def drawn(self, left: float, top: float) -> tuple[str, float]:
        """Write it at a place of the picture.

        Returns:
            SVG, and the height that it takes.
        """
        above = 6 + 17 * bool(self.title) + 17 * bool(self._legend)
        pieces = [*self._frame(), *self._marks]
        head = list(self._head(above))
        inner = "".join(pieces)
        return (
            f'<g transform="translate({left:.1f} {top + above:.1f})">{inner}{"".join(head)}</g>',
            above + self.height + 40,
        )

    def _head(self, above: int) -> Iterator[str]:
        if self.title:
            yield f'<text x="{self.left}" y="{12 - above}" fill="{INK}">{text(self.title)}</text>'
        at = float(self.left)
        for label, colour, dashed in self._legend:
            dash = ' stroke-dasharray="5 4"' if dashed else ""
            yield (
                f'<path d="M{at:.0f} -12h16" stroke="{colour}" stroke-width="3"{dash}/>'
                f'<text x="{at + 21:.0f}" y="-8" fill="{INK}">{text(label)}</text>'
            )
            at += 38 + 6.4 * len(label)

    def _frame(self) -> Iterator[str]:
        width, height = self._width, self.height
        yield f'<path d="M{self.left} 0V{height}h{width:.1f}" fill="none" stroke="{GREY}"/>'
        for value, word in self.x.marks():
            px = self.left + self.x.share(value) * width
            yield f'<path d="M{px:.1f} {height}v4" stroke="{GREY}"/>'
            yield (
                f'<text x="{px:.1f}" y="{height + 16}" fill="{GREY}" text-anchor="middle">'
                f"{text(word)}</text>"
            )
        for value, word in self.y.marks():
            py = (1.0 - self.y.share(value)) * height
            yield f'<path d="M{self.left} {py:.1f}h-4" stroke="{GREY}"/>'
            yield (
                f'<text x="{self.left - 7}" y="{py + 4:.1f}" fill="{GREY}" text-anchor="end">'
                f"{text(word)}</text>"
            )
        middle = self.left + width / 2
        yield (
            f'<text x="{middle:.1f}" y="{height + 32}" fill="{INK}" text-anchor="middle">'
            f"{text(self.x.label)}</text>"
        )
        if self.y.label:
            yield (
                f'<text transform="translate(11 {height / 2:.0f}) rotate(-90)" fill="{INK}" '
                f'text-anchor="middle">{text(self.y.label)}</text>'
            )


def picture(caption: str, *rows: Sequence[Panel]) -> str:
    """Write panels, row by row, with a caption that is also read out in their place."""
    said = text(caption)
    pieces: list[str] = []
    top = 0.0
    for row in rows:
        left, tallest = 0.0, 0.0
        for panel in row:
            drawn, height = panel.drawn(left, top)
            pieces.append(drawn)
            left += WIDTH * panel.share
            tallest = max(tallest, height)
        top += tallest
    return (
        f'<figure><svg viewBox="0 0 {WIDTH} {top:.0f}" role="img" aria-label="{said}">'
        f"{''.join(pieces)}</svg><figcaption>{said}</figcaption></figure>"
    )


def along(names: Sequence[str], where: dict[str, float | None] | None) -> tuple[Vector, str]:
    """Take the ring as the horizontal axis where every place is known, else the order.

    Returns:
        Position of every name, shape (k,), and the label of the axis.
    """
    places = [where.get(name) for name in names] if where else []
    if places and all(place is not None for place in places):
        return values(places), "s [m]"
    return np.arange(len(names), dtype=float), "in the order of the record"


def shorten(name: str, most: int = 24) -> str:
    """Make a name as long as there is room."""
    plain = "".join(sign for sign in name if sign.isprintable())
    return plain if len(plain) <= most else f"{plain[: most - 1]}…"
