"""The page of the files names exactly what a real post-mortem holds."""

import re

import h5py
import numpy as np

from orbitfb.core.clock import ManualClock
from orbitfb.core.signals import Channels, LoopState, Orbit, Phases, Reading, TickRecord
from orbitfb.history.columns import layout
from orbitfb.postmortem.encoding import encode
from orbitfb.postmortem.frozen import Frozen
from orbitfb.postmortem.settings import PostMortemSettings
from orbitfb.postmortem.tape import Tape

NAMES = ("A", "B")
CHANNELS = Channels("x", NAMES, NAMES, NAMES, NAMES, NAMES)


def frozen() -> Frozen:
    zeros = np.zeros(2)
    reading = Reading(Orbit(zeros, np.ones(2, dtype=bool), 1e9), zeros, {"current": 0.4}, 1e9)
    vectors = dict.fromkeys(("reference", "setpoints", "requested", "dither", "applied"), zeros)
    record = TickRecord(
        tick=0,
        state=LoopState.CLOSED,
        reason="",
        reading=reading,
        **vectors,
        scale=1.0,
        written=1e9,
        policy_id="svd",
        phases=Phases(0.0, 0.0, 0.0, 0.0, 0.0),
        latency=1e-3,
        missed=0,
    )
    tape = Tape(PostMortemSettings(), ManualClock())
    tape.tick(record)
    return tape.now("me")


def test_a_post_mortem_is_as_the_page_says(docs, tmp_path):
    page = (docs / "reference/files.md").read_text(encoding="utf-8")
    part = page.split("\n## Post-mortem\n")[1].split("\n## ")[0]
    listed = {found[0]: found[2] for found in re.findall(r"\| `([^`]+)` \|(.*?)\|(.*?)\|", part)}
    path = tmp_path / "x.h5"
    path.write_bytes(encode(frozen(), CHANNELS, np.ones(2, dtype=bool), "", {}))
    with h5py.File(path) as file:
        found = {}
        file.visititems(lambda name, item: found.update({name: item.attrs.get("units", "")}))
        assert set(file.attrs) == {"schema_version"}
    archive = set(layout(CHANNELS, ["current"])) | {"channels/bpms", "channels/correctors"}
    groups = {"auxiliary", "channels", "events", "more"}
    shown = {re.sub(r"^more/.*", "more/NAME", name) for name in found}
    assert shown - archive - groups == set(listed) - {"schema_version"}
    for name in ("since_trip", "ended", "phases", "reason"):
        assert found[name] == listed[name].strip()
