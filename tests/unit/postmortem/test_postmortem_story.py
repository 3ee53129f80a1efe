"""What a post-mortem tells: when, why, what went wrong first, what changed."""

import json
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest
from postmortem_loop import PATIENCE, Loop, ring
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.signals import TickRecord
from orbitfb.postmortem.encoding import encode
from orbitfb.postmortem.reading import read_postmortem
from orbitfb.postmortem.settings import PostMortemSettings
from orbitfb.postmortem.story import lines, story_of, values
from orbitfb.postmortem.tape import Tape


def told(loop, last=10.0):
    loop.settle()
    story = story_of(read_postmortem(loop.files()[-1]), last)
    return story, "\n".join(lines(story))


def test_a_lost_beam_names_no_device(tripped):
    loop, _ = tripped
    story, text = told(loop)
    assert "tick 60, was CLOSED" in text
    assert "reason: stored current 0 mA is below" in text
    assert "stored current: 400 mA before, 0 mA at the trip" in text
    assert "first BPM: none" in text and "first corrector: none" in text
    assert "+0.00 s  CLOSED → TRIPPED: stored current 0 mA" in text
    assert "+0.00 s  the stored current went from 400 to 0 mA" in text
    rms = [
        float(np.sqrt(np.mean(record.reading.orbit.position**2))) for record in loop.records[:61]
    ]
    assert story.analysis.rms[30] == pytest.approx(rms[60])
    assert story.analysis.orbit.at == pytest.approx(rms[60])


def test_the_bpm_that_left_first_is_named_with_when(loop):
    """BPM3 runs away for four ticks, then the whole orbit jumps."""
    loop.ticks(50)
    for step in (1, 2, 3, 4):
        loop.machine.disturbance[3] = 1e-4 * step
        loop.ticks(1)
    loop.machine.disturbance[:] = 5e-3
    loop.ticks(20)
    story, text = told(loop)
    first = story.analysis.bpm
    assert (first.name, first.since_trip) == ("BPM3", pytest.approx(-0.4, abs=1e-5))
    assert "first BPM: BPM3, -0.40 s: " in text
    assert story.analysis.orbit.before < 1e-6 < 1e-3 < story.analysis.orbit.at
    assert story.analysis.peak_bpm in loop.machine.channels.bpms


def test_bpms_that_were_lost_are_named(loop):
    """BPM0 is lost (masked), a second later the beam is."""
    loop.ticks(40)
    loop.ticks(10, *["one_nan"] * 10)
    loop.machine.current = 0.0
    loop.ticks(20, *["one_nan"] * 3)
    story, text = told(loop)
    assert (story.analysis.bpm.name, story.analysis.bpm.what) == ("BPM0", "became invalid")
    assert "BPMs became invalid: BPM0" in text


def test_steps_of_the_rf_are_told_and_whose_they_were(loop):
    """The loop steps by 0.5 Hz, which shows an orbit later; then somebody else by 30 Hz."""
    read, tick = loop.machine.read, iter(range(1000))

    def reading(timeout):
        its, now = read(timeout), next(tick)
        frequency = 5e8 + 0.5 * (now > 40) + 30.0 * (now > 45)
        rf = {"rf_frequency": frequency, "rf_step": 0.5 * (now == 40)}
        return replace(its, auxiliary={**its.auxiliary, **rf})

    loop.machine.read = reading
    loop.ticks(50)
    loop.machine.current = 0.0
    loop.ticks(20)
    _, text = told(loop)
    assert text.count("the RF frequency was stepped by +0.5 Hz") == 1
    assert text.count("not by this loop") == 1
    assert "from 500000000.500 to 500000030.500 Hz, not by this loop" in text


def test_the_corrector_that_left_first_is_named(tmp_path):
    loop = Loop(tmp_path / "postmortem")
    loop.ticks(40)
    loop.machine.readback_offset[2] = -0.7
    loop.ticks(5)
    loop.machine.current = 0.0
    loop.ticks(20)
    story, text = told(loop)
    assert story.analysis.corrector.name == "COR2"
    assert story.analysis.corrector.since_trip == pytest.approx(-0.5, abs=1e-5)
    assert "its readback was -0.7 A from its setpoint" in text
    assert "CLOSED → HELD: 1 correctors do not follow their setpoint: COR2" in text


def test_thresholds_are_those_of_the_run(tmp_path):
    """The configuration in the file allows 0.2 A."""
    loop = Loop(tmp_path / "postmortem")
    loop.ticks(40)
    loop.machine.readback_offset[2] = 0.15
    loop.ticks(1)
    loop.machine.current = 0.0
    loop.ticks(20)
    story, _ = told(loop)
    assert story.analysis.corrector is None


def test_changes_are_told_in_their_order(loop):
    loop.ticks(40)
    loop.slot.swap(ring.InversePolicy("another"))
    loop.ticks(3)
    loop.machine.inside = loop.machine.inside + np.array([0.5, 0.0, 0.0, 0.0])
    loop.ticks(5)
    loop.ticks(20, "beam_lost")
    story, _ = told(loop)
    said = [change.text for change in story.changes]
    assert said.index("policy another instead of inverse") < said.index(
        "setpoints moved by somebody else, by up to 0.5 A: COR0"
    )
    assert [c.since_trip for c in story.changes] == sorted(c.since_trip for c in story.changes)
    short, _ = told(loop, last=0.3)
    assert len(short.changes) < len(story.changes)
    assert all(change.since_trip >= -0.3 for change in short.changes)


@dataclass(frozen=True, slots=True, kw_only=True)
class Richer(TickRecord):
    """A record with more than the columns know."""

    left_out: np.ndarray
    verdict: str
    causes: tuple[str, ...]


def test_whatever_else_a_record_has_is_kept_and_its_changes_told(loop, tmp_path):
    loop.ticks(20)
    tape = Tape(PostMortemSettings(), loop.clock)
    for record in loop.records[10:]:
        values = {field.name: getattr(record, field.name) for field in fields(record)}
        late = record.tick > 15
        more = {"left_out": np.array([late]), "verdict": "skip" if late else "", "causes": ("a",)}
        tape.tick(Richer(**values, **more))
    path = tmp_path / "x.h5"
    counting = np.ones(ring.N, dtype=bool)
    path.write_bytes(encode(tape.now("me"), loop.machine.channels, counting, "", {}))
    its = read_postmortem(path)
    assert its.more["left_out"].dtype == np.bool_ and its.more["left_out"].sum() == 4
    assert its.more["causes"][0] == b'["a"]'
    assert [change.text for change in story_of(its, 10.0).changes] == ["verdict: skip"]


def test_no_ticks_at_all_is_a_story_too(loop):
    loop.recorder.request("too early").result(PATIENCE)
    _, text = told(loop)
    assert "no tick is kept" in text


@pytest.mark.parametrize("count", [1, 2])
def test_hardly_any_ticks(loop, count):
    loop.ticks(count, "missing")
    loop.recorder.request("early").result(PATIENCE)
    story, _ = told(loop)
    assert json.dumps(values(story), allow_nan=False)


def run(*arguments):
    return CliRunner().invoke(app, ["postmortem", *map(str, arguments)])


def test_the_command_tells_and_draws(tripped, tmp_path):
    loop, path = tripped
    out = tmp_path / "picture.png"
    done = run(path.name, "--data", loop.directory.parent, "--out", out)
    assert done.exit_code == 0, done.output
    assert "reason: stored current 0 mA" in done.output and f"picture: {out}" in done.output
    assert out.read_bytes().startswith(b"\x89PNG")
    assert not list(tmp_path.glob(".*"))


def test_the_page_fetches_nothing_and_escapes_what_the_file_brought(loop, tmp_path):
    loop.ticks(20)
    loop.recorder.tell("info", "<script>", {"x": "<img src=http://x>\x1b[2J"})
    loop.recorder.request("<b>me</b>\x1b[31m").result(PATIENCE)
    loop.settle()
    done = run(loop.files()[0], "--out", tmp_path / "x.html")
    page = (tmp_path / "x.html").read_text()
    assert "<script" not in page and "<img src=http" not in page and "<b>me" not in page
    assert "\x1b" not in done.output and "\x1b" not in page


def test_the_command_lists_what_there_is(tripped, tmp_path):
    loop, path = tripped
    data = loop.directory.parent
    (loop.directory / "postmortem-20010101T000000.000000Z.h5").write_bytes(b"broken")
    done = run("--data", data)
    broken, whole = done.output.splitlines()
    assert path.name in whole and "TRIPPED" in whole and "stored current" in whole
    assert "is damaged, or no post-mortem" in broken
    listed = json.loads(run("--data", data, "--json").output)["postmortems"]
    assert [its["file"] for its in listed][1] == str(path) and "problem" in listed[0]
    out = run("last", "--data", data, "--out", tmp_path / "x.svg", "--json")
    answer = json.loads(out.output)
    assert answer["tick"] == 60 and answer["stored_current"]["at"] == 0.0
    assert "<svg" in (tmp_path / "x.svg").read_text()[:2000]
    nothing = run("--data", tmp_path / "nowhere")
    assert nothing.exit_code == 0 and "the loop has not tripped" in nothing.output


def test_what_cannot_be_drawn_is_said(tripped, tmp_path):
    _, path = tripped
    for out, said in (("x.jpg", "name a file that ends in"), ("no/x.png", "cannot be written")):
        done = run(path, "--out", tmp_path / out)
        assert done.exit_code != 0 and said in str(done.exception)
