"""How effects are written down, and what is said when they are written wrong."""

import numpy as np
import pytest

from orbitfb.config.load import load_config
from orbitfb.core.errors import ConfigError
from orbitfb.core.units import parse_quantity
from orbitfb.effects.files import effects_toml, read_effects
from orbitfb.effects.places import resolve
from orbitfb.effects.settings import EffectSettings, parse_effect
from orbitfb.records.cells import cell_of

pytestmark = pytest.mark.usefixtures("examples")


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("0.1", "s", 0.1),
        ("0.1s", "s", 0.1),
        ("50ms", "s", 0.05),
        ("2 min", "s", 120.0),
        ("2%", "1", 0.02),
        ("-3e-2", "1", -0.03),
        ("20um", "m", 20e-6),
        ("20µm", "m", 20e-6),
        ("5mrad", "rad", 5e-3),
        ("180deg", "rad", np.pi),
        ("3kHz", "Hz", 3e3),
        ("2mm/A", "m/A", 2e-3),
        ("2um/mA", "m/A", 2e-3),
        ("3mm²", "m²", 3e-6),
        ("3mm^2", "m²", 3e-6),
        ("4 1/m", "1/m", 4.0),
        ("1mA", "A", 1e-3),
    ],
)
def test_quantities(text, unit, value):
    assert parse_quantity(text, unit) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        ("5m", "s"),
        ("5A", "m"),
        ("five", "s"),
        ("5%", "m"),
        ("1e999", "s"),
        ("3mm", "m²"),
        ("", "s"),
    ],
)
def test_what_is_no_quantity(text, unit):
    with pytest.raises(ValueError, match=r"no number|no unit|not finite"):
        parse_quantity(text, unit)


def test_the_text_of_the_command_line():
    its = parse_effect("example-gain:gain=2%,tau=50ms,cells=3-5+C07,from=30s,planes=x")
    assert its == EffectSettings(
        id="example-gain",
        values={"gain": 0.02, "tau": 0.05},
        cells=("3-5", "C07"),
        since=30.0,
        planes="x",
    )
    assert parse_effect(its.text) == its
    assert parse_effect("example-gain").filled == {"gain": 0.1, "tau": 0.1}
    assert parse_effect("example-gain:gain=0.2,cells=all").cells == ()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("exampel-gain", r"no effect is called 'exampel-gain' \(did you mean example-gain"),
        ("example-gain:tua=1", r"no such parameter: tua \(did you mean tau\?\); example-gain has"),
        ("example-gain:size=1", r"no such parameter: size; example-gain has gain \(-0.5 to 0.5\)"),
        ("example-gain:gain=0.7", r"gain: 0.7 is out of bounds; gain \(-0.5 to 0.5\)"),
        ("example-gain:gain=2mm", "gain: 'mm' is no unit"),
        ("example-gain:tau=11s", r"tau \(0 to 10 s\)"),
        ("example-gain:tau", "'tau' is not KEY=VALUE"),
        ("example-gain:tau=1,tau=2", "tau is given twice"),
        ("example-gain:planes=z", "planes: Input should be 'x', 'y' or 'xy'"),
        ("example-gain:from=-3s", "from: Input should be greater than or equal to 0"),
        ("example-gain:cells=3,names=A", "by cells or by names, not by both"),
    ],
)
def test_wrong_texts_say_what_is_allowed(text, words):
    with pytest.raises(ConfigError, match=words):
        parse_effect(text)


def test_files_are_read_as_they_were_written(tmp_path):
    effects = (
        parse_effect("example-gain:gain=2%,cells=3-5,from=30s,planes=x"),
        parse_effect("example-ramp:names=PH1A_C30+PH2A_C30"),
        parse_effect("example-ring"),
    )
    path = tmp_path / "effect.toml"
    path.write_text(effects_toml(effects, "Found by a test."), encoding="utf-8")
    assert read_effects(path) == effects
    # The same file is a configuration.
    assert load_config(path, environment={}).effect == effects


def test_a_configuration_names_the_effect_and_the_line(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text('[[effect]]\nid = "example-gain"\nvalues = { gain = "90%" }\n', "utf-8")
    with pytest.raises(ConfigError, match=r"effect\.0\.values: .*gain: 0.9 is out of bounds"):
        load_config(path, environment={})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[loop]\nrate_hz = 3\n", "loop is not for a file of effects"),
        ("effect = 3\n", "write \\[\\[effect\\]\\]"),
        ("effect = \n", "is not TOML"),
        (
            '[[effect]]\nid = "example-gain"\nsize = 3\n',
            "effect 1: .* no such key: size; there are",
        ),
        ("[[effect]]\nvalues = { gain = 0.1 }\n", "the key id is missing"),
    ],
)
def test_wrong_files(tmp_path, content, words):
    path = tmp_path / "effect.toml"
    path.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match=words):
        read_effects(path)


def _names(text, layout):
    its = parse_effect(text)
    devices = layout.bpms if its.kind.target == "bpm" else layout.correctors
    return [devices.label(int(column)) for column in resolve(its, layout)]


def test_places(layout, both_planes):
    assert cell_of("PH1A_C30") == "C30"
    assert cell_of("SR01-BPM3") == ""
    three = _names("example-gain:cells=3-5", layout)
    assert len(three) == 18
    assert {name[-7:-4] for name in three} == {"C03", "C04", "C05"}
    across = _names("example-gain:cells=29-1", layout)
    assert {name[-7:-4] for name in across} == {"C29", "C30", "C01"}
    assert len(_names("example-gain", layout)) == 180
    assert len(_names("example-gain", both_planes)) == 360
    assert _names("example-ramp:names=PL2A_C01+PL1A_C01", layout) == [
        "PL2A_C01 (x)",
        "PL1A_C01 (x)",
    ]
    both = _names("example-ramp:names=PL2A_C01", both_planes)
    assert both == ["PL2A_C01 (x)", "PL2A_C01 (y)"]
    assert _names("example-ramp:names=PL2A_C01,planes=y", both_planes) == both[1:]
    assert resolve(parse_effect("example-ring"), layout).shape == (0,)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("example-gain:names=PL1A_C01", "no correctors called 'PL1A_C01'"),
        ("example-gain:names=C5", "of another ring need its places table"),
        ("example-gain:cells=31", "'31' is no cell with correctors"),
        ("example-gain:planes=y", "no correctors are left in planes y"),
        ("example-ring:cells=3", "is on the whole ring"),
    ],
)
def test_places_that_are_not_there(layout, text, words):
    with pytest.raises(ConfigError, match=words):
        resolve(parse_effect(text), layout)


@pytest.mark.parametrize("text", ["corrector-gain:", "corrector-gain: "])
def test_nothing_after_the_colon_is_refused(text):
    with pytest.raises(ConfigError, match="nothing follows the colon; write KEY=VALUE pairs"):
        parse_effect(text)
