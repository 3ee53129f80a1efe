"""Screens of Phoebus (`.bob`, display version 2): widgets with their PVs, as XML."""

from collections.abc import Sequence
from xml.etree import ElementTree as Xml

from orbitfb.panel.pv import Kind, PanelPv

PREFIX = "$(P)"
"""The macro that holds the prefix of the panel."""

Colour = tuple[int, int, int]
Box = tuple[int, int, int, int]
"""Left, top, width, height [pixels]."""

MARGIN = 10
"""Between the last widget and the edge of the window [pixels]."""

_TEXT_FORMAT = "6"
"""How Phoebus shows an array of characters as text."""


class Screen:
    """A display that grows widget by widget.

    Args:
        name: Title of the window.
        prefix: Of the panel's PVs; the default of the macro `P`.
        width: Of the window [pixels].
        height: Of the window, unless its widgets need more [pixels].
    """

    def __init__(self, name: str, prefix: str, width: int, height: int) -> None:
        self._root = Xml.Element("display", version="2.0.0")
        _put(self._root, name=name)
        macros = Xml.SubElement(self._root, "macros")
        _put(macros, P=prefix)
        _put(self._root, width=width, height=height)
        self._height, self._count = height, 0

    def text(self) -> str:
        """Give the file."""
        for height in self._root.findall("height"):
            height.text = str(self._height)
        Xml.indent(self._root)
        head = '<?xml version="1.0" encoding="UTF-8"?>\n'
        return head + Xml.tostring(self._root, encoding="unicode") + "\n"

    def label(self, words: str, box: Box, *, bold: bool = False, size: float = 14.0) -> None:
        """Put words."""
        widget = self._widget("label", "2.0.0", box)
        _put(widget, text=words)
        font = Xml.SubElement(widget, "font")
        style = "BOLD" if bold else "REGULAR"
        Xml.SubElement(font, "font", family="Liberation Sans", style=style, size=str(size))

    def value(self, pv: PanelPv, box: Box, size: float = 14.0) -> None:
        """Put what a PV holds; nobody can write it there."""
        widget = self._widget("textupdate", "2.0.0", box, pv)
        font = Xml.SubElement(widget, "font")
        Xml.SubElement(font, "font", family="Liberation Sans", style="REGULAR", size=str(size))
        if pv.kind is Kind.TEXT:
            _put(widget, format=_TEXT_FORMAT, wrap_words="true")

    def entry(self, pv: PanelPv, box: Box) -> None:
        """Put a field to write into a PV: a choice, a number or a text."""
        if pv.kind is Kind.CHOICE:
            self._widget("combo", "2.0.0", box, pv)
            return
        widget = self._widget("textentry", "3.0.0", box, pv)
        if pv.kind is Kind.TEXT:
            _put(widget, format=_TEXT_FORMAT)

    def lamp(self, pv: PanelPv, box: Box, colours: dict[str, Colour]) -> None:
        """Put a lamp that has a colour for each word of a choice."""
        widget = self._widget("multi_state_led", "2.0.0", box, pv)
        states = Xml.SubElement(widget, "states")
        for number, word in enumerate(pv.states):
            state = Xml.SubElement(states, "state")
            _put(state, value=number, label=word)
            _colour(Xml.SubElement(state, "color"), colours[word])
        _put(widget, square="true")

    def button(self, words: str, box: Box, pv: PanelPv, value: str) -> None:
        """Put a button that writes one value."""
        widget = self._widget("action_button", "3.0.0", box)
        _put(widget, text=words, pv_name=PREFIX + pv.name)
        action = self._action(widget, "write_pv", words)
        _put(action, pv_name="$(pv_name)", value=value)

    def way_to(self, words: str, box: Box, file: str) -> None:
        """Put a button that opens another screen."""
        widget = self._widget("action_button", "3.0.0", box)
        _put(widget, text=words)
        _put(self._action(widget, "open_display", words), file=file, target="tab")

    def course(self, pvs: Sequence[PanelPv], box: Box, title: str) -> None:
        """Put numbers over time."""
        widget = self._widget("stripchart", "2.1.0", box)
        _put(widget, title=title, start="5 minutes", show_toolbar="false")
        self._axis(widget, title)
        traces = Xml.SubElement(widget, "traces")
        for number, pv in enumerate(pvs):
            trace = Xml.SubElement(traces, "trace")
            _put(trace, name=pv.name, y_pv=PREFIX + pv.name, axis=0, line_width=2)
            _colour(Xml.SubElement(trace, "color"), _TRACES[number % len(_TRACES)])

    def vector(self, pvs: Sequence[PanelPv], box: Box, title: str) -> None:
        """Put the elements of vectors side by side, each along what it says."""
        widget = self._widget("xyplot", "3.0.0", box)
        _put(widget, title=title, show_toolbar="false")
        self._axis(widget, pvs[0].units)
        traces = Xml.SubElement(widget, "traces")
        for number, pv in enumerate(pvs):
            trace = Xml.SubElement(traces, "trace")
            along = PREFIX + pv.along if pv.along else ""
            _put(trace, name=pv.name, x_pv=along, y_pv=PREFIX + pv.name, axis=0, line_width=1)
            _colour(Xml.SubElement(trace, "color"), _TRACES[number % len(_TRACES)])

    def _widget(self, kind: str, version: str, box: Box, pv: PanelPv | None = None) -> Xml.Element:
        self._count += 1
        self._height = max(self._height, box[1] + box[3] + MARGIN)
        widget = Xml.SubElement(self._root, "widget", type=kind, version=version)
        _put(widget, name=f"{kind} {self._count}")
        if pv is not None:
            _put(widget, pv_name=PREFIX + pv.name, tooltip=f"$(pv_name): {pv.meaning}\n$(pv_value)")
        _put(widget, x=box[0], y=box[1], width=box[2], height=box[3])
        return widget

    @staticmethod
    def _action(widget: Xml.Element, kind: str, words: str) -> Xml.Element:
        action = Xml.SubElement(Xml.SubElement(widget, "actions"), "action", type=kind)
        _put(action, description=words)
        return action

    @staticmethod
    def _axis(widget: Xml.Element, title: str) -> None:
        axis = Xml.SubElement(Xml.SubElement(widget, "y_axes"), "y_axis")
        _put(axis, title=title, autoscale="true", show_grid="true", visible="true")


_TRACES: tuple[Colour, ...] = ((0, 90, 181), (220, 50, 32), (120, 120, 120))


def _put(element: Xml.Element, **texts: object) -> None:
    for name, text in texts.items():
        Xml.SubElement(element, name).text = str(text)


def _colour(element: Xml.Element, colour: Colour) -> None:
    red, green, blue = map(str, colour)
    Xml.SubElement(element, "color", red=red, green=green, blue=blue)
