"""The report of a diagnosis: whole, alone, harmless, and honest about what is missing."""

import base64
import functools
import re
from html import escape
from html.parser import HTMLParser
from xml.etree import ElementTree

import examples
import pytest

from orbitfb.diagnose.report import answer_sections
from orbitfb.diagnose.report.document import page

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
    found = re.findall(r'src="data:image/svg\+xml;base64,([^"]+)"', text)
    return [base64.b64decode(one) for one in found]


def test_a_full_diagnosis_has_all_its_pictures_inside(rich):
    drawn = pictures(rich)
    assert len(drawn) == 16
    for one in drawn:
        assert ElementTree.fromstring(one).tag.endswith("svg")
    assert "not computed" not in rich


def test_the_headline_comes_first(rich):
    text = "".join(read(rich).text)
    assert text.index("lag of a corrector") < text.index("Where the gap lies")


@pytest.mark.parametrize("name", ["named", "bare", "unknown", "broken"])
def test_the_page_asks_for_nothing_from_anywhere(name):
    reader = read(drawn(name))
    assert not {"script", "link", "iframe", "object", "embed", "base"} & set(reader.tags)
    for key, value in reader.attributes:
        assert not key.startswith("on")
        if key in ("src", "href"):
            assert value.startswith(("data:image/svg+xml;base64,", "#"))


def test_every_link_has_its_section(rich):
    reader = read(rich)
    links = {value[1:] for key, value in reader.attributes if key == "href"}
    assert links
    assert links <= {value for key, value in reader.attributes if key == "id"}


def test_what_is_missing_is_said_and_not_drawn():
    text = drawn("bare")
    assert not pictures(text)
    for what in ("gap", "tournament", "score map", "shrink", "closed loop", "experiment"):
        assert re.search(rf"The {what}[^<]*: not computed|An {what}: not computed", text), what


def test_a_record_that_is_not_intact_gets_its_findings_and_no_estimates():
    text = drawn("broken")
    assert "readback-differs" in text
    assert "tournament" not in text


def test_unresolved_numbers_are_words_and_never_nan(rich):
    text = "".join(read(rich).text)
    assert "not resolved" in text
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
    document["maps"][0]["row_names"] = (HOSTILE,) * 3
    document["maps"][0]["title"] = HOSTILE
    document["fingerprints"][0]["x_label"] = HOSTILE
    document["findings"][0]["text"] = HOSTILE
    document["audit"]["worst_channels"] = {HOSTILE: 1.0}
    document["unknown"] = {"text": HOSTILE, "places": (HOSTILE,), "stages": {HOSTILE: 0.5}}
    text = page(type(its).model_validate(document))
    assert "script" not in read(text).tags
    assert "\x1b" not in text
    assert "\u202e" not in text
    assert "&lt;script&gt;alert(1)" in text
    for one in pictures(text):
        assert b"script" not in re.sub(rb"<!--.*?-->", b"", one, flags=re.DOTALL)
        ElementTree.fromstring(one)


def test_the_same_diagnosis_gives_the_same_page():
    assert page(examples.unknown()) == drawn("unknown")


def test_on_a_narrow_screen_links_wrap_and_sentences_stay_wide(rich):
    assert re.search(r"nav \{[^}]*flex-wrap: wrap", rich)
    assert re.search(r"\.sentence \{[^}]*min-width: 16rem", rich)
    told = re.findall(r'<td><div class="sentence">(.*?)</div></td>', rich)
    assert escape(examples.named().findings[0].text) in told


def test_the_class_of_a_cause_has_the_cause_itself_in_it():
    cause = examples.lag_cause().model_copy(update={"alternatives": ("corrector-slew",)})
    said = answer_sections.causes(examples.named(causes=(cause,)))
    assert "its class: corrector-lag, corrector-slew" in said
