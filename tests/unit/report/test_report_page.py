"""The report of a diagnosis: whole, alone, harmless, and honest about what is missing."""

import functools
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import pytest

from orbitfb.diagnose.report import opening
from orbitfb.diagnose.report.document import page
from tests.unit.result import examples

HOSTILE = "<script>alert(1)</script>\"'&$x^$\x1b[2J\u202e"


class Reader(HTMLParser):
    """Collects what a browser would be told to do."""

    void = frozenset({"meta", "img", "br"})

    def __init__(self):
        super().__init__()
        self.tags, self.attributes, self.text, self.open = [], [], [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += attrs
        if tag not in self.void:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)


def read(text):
    reader = Reader()
    reader.feed(text)
    reader.close()
    assert not reader.open
    return reader


@functools.cache
def drawn(name):
    """The page of an example: drawing takes seconds, and tests only read it."""
    return page(getattr(examples, name)())


@pytest.fixture
def rich():
    return drawn("named")


def pictures(text):
    return re.findall(r"<svg .*?</svg>", text)


def test_a_full_diagnosis_has_all_its_pictures_inside(rich):
    drawn = pictures(rich)
    assert len(drawn) == 11
    for one in drawn:
        assert ElementTree.fromstring(one).tag == "svg"
    assert "not computed" not in rich


def test_the_headline_comes_first(rich):
    text = "".join(read(rich).text)
    assert text.index("Lag of a corrector") < text.index("Where and when")


@pytest.mark.parametrize("name", ["named", "bare", "unknown", "broken"])
def test_the_page_asks_for_nothing_from_anywhere(name):
    reader = read(drawn(name))
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(reader.tags)
    for key, value in reader.attributes:
        assert not key.startswith("on")
        if key in ("src", "href"):
            assert value.startswith("#")


def test_every_link_has_its_section(rich):
    reader = read(rich)
    links = {value[1:] for key, value in reader.attributes if key == "href"}
    assert links
    assert links <= {value for key, value in reader.attributes if key == "id"}


def test_what_is_missing_is_said_and_not_drawn():
    text = drawn("bare")
    assert not pictures(text)
    for what in (
        "What causes do to the orbit",
        "Where the gap lies",
        "The comparison of effects",
        "An experiment",
        "The audit",
    ):
        assert re.search(rf"{what}[^<]*: not computed", text), what


def test_a_record_that_is_not_intact_gets_its_findings_and_no_estimates():
    text = drawn("broken")
    assert "stays while its setpoint moves" in text
    assert "evidence" not in text.split("</style>")[1]


def test_unresolved_numbers_are_words_and_never_nan(rich):
    text = "".join(read(rich).text)
    assert not re.search(r"\b(nan|None|inf)\b", text)


def test_names_from_a_record_can_neither_run_nor_break_a_picture():
    its = examples.named()
    document = its.model_dump()
    document["headline"] = HOSTILE
    document["provenance"]["source"] = HOSTILE
    cause = document["causes"][0]
    for key in ("title", "sentence", "label"):
        cause[key] = HOSTILE
    cause["places"] = cause["alternatives"] = cause["places_within"] = (HOSTILE,)
    cause["parameters"] = {HOSTILE: {"value": 1.0, "unit": HOSTILE}}
    for part in ("by_stage", "by_bpm", "by_corrector", "um_by_bpm"):
        document["gap"][part] = {HOSTILE: 0.1, "$": 0.2}
    document["geometry"] = None
    document["tournament"]["rows"][0]["effect"] = HOSTILE
    document["tournament"]["rows"][0]["places"] = HOSTILE
    document["waterfall"][0]["label"] = HOSTILE
    document["fingerprints"][0]["x_label"] = HOSTILE
    document["findings"][0]["text"] = HOSTILE
    document["audit"]["worst_channels"] = {HOSTILE: 1.0}
    document["unknown"] = {"text": HOSTILE, "places": (HOSTILE,)}
    text = page(type(its).model_validate(document))
    assert "script" not in read(text).tags
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert "&lt;script&gt;alert(1)" in text
    for one in pictures(text):
        ElementTree.fromstring(one)


def test_the_same_diagnosis_gives_the_same_page():
    assert page(examples.unknown()) == drawn("unknown")


def test_on_a_narrow_screen_links_wrap_and_wide_things_scroll(rich):
    assert re.search(r"nav \{[^}]*flex-wrap: wrap", rich)
    assert re.search(r"\.wide \{ overflow-x: auto", rich)
    assert re.search(r"figure \{[^}]*overflow-x: auto", rich)
    assert rich.count("<table>") == rich.count('<div class="wide"><table>')


def test_in_the_dark_the_page_has_other_colours_and_pictures_take_them(rich):
    assert "@media (prefers-color-scheme: dark)" in rich
    for one in pictures(rich):
        assert not re.search(r'(fill|stroke)="(#|black|white)', one)
    light, dark = (set(re.findall(r"(--[a-z]+):", part)) for part in _schemes(rich))
    assert light <= dark | {"--badge"}


def _schemes(text):
    style = text.split("<style>")[1].split("</style>")[0]
    dark = style.index("@media (prefers-color-scheme: dark)")
    return style[:dark], style[dark : style.index("box-sizing")]


def test_numbers_have_prefixes_and_no_exponents(rich):
    text = "".join(read(rich).text)
    assert not re.search(r"\de-\d", text)
    assert "93 [88, 98] ms" in text


def test_the_page_has_one_probability(rich):
    text = "".join(read(rich).text)
    assert set(re.findall(r"probability (above )?([0-9.]*[0-9])", text)) == {("", "0.98")}


def test_other_names_of_a_cause_are_told():
    cause = examples.lag_cause().model_copy(update={"alternatives": ("corrector-slew",)})
    said = opening.causes(examples.named(causes=(cause,)))
    assert "May also be: corrector-slew." in said
