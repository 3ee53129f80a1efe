"""The page of the files names exactly what the file of a measured response holds."""

import json
import re
import types

import numpy as np
from safetensors import safe_open

from orbitfb.app.response.answer import about_of
from orbitfb.config.tree import AppConfig
from orbitfb.core.signals import Channels
from orbitfb.measure.column import Table
from orbitfb.measure.judging import Judgement
from orbitfb.measure.response_file import write_response

NAMES = ("P0", "P1", "P2")
CHANNELS = Channels("x", NAMES, NAMES, NAMES, NAMES, NAMES)


def test_measured_response(docs, tmp_path):
    page = (docs / "reference/files.md").read_text(encoding="utf-8")
    section = page.split("## Measured response\n")[1].split("\n## ")[0]
    arrays, entries = section.split("| entry |")
    file = tmp_path / "response.safetensors"
    result = types.SimpleNamespace(check={0: 0.01})
    about = about_of(AppConfig(), result, "here", 1.0, 2.0, 0, CHANNELS)
    judged = Judgement({}, {}, ())
    write_response(file, Table.empty(3, 3), np.zeros(3), CHANNELS, judged, about)
    with safe_open(file, "np") as opened:
        assert set(re.findall(r"^\| `(\w+)`", arrays, re.MULTILINE)) == set(opened.keys())
        assert set(opened.metadata()) == {"card"}
        card = json.loads(opened.metadata()["card"])
    assert set(re.findall(r"^\| `(\w+)`", entries, re.MULTILINE)) == set(card)
