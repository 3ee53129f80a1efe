"""Effects on single elements of the response, in the plant and in files."""

import numpy as np
import pytest

from orbitfb.core.errors import ConfigError
from orbitfb.effects.build import build, layout_of, measured_response
from orbitfb.effects.files import effects_toml, read_effects
from orbitfb.effects.settings import EffectSettings, parse_effect


def test_elements_of_a_response_are_changed_one_by_one_and_come_again_from_a_file(ring, tmp_path):
    one, other = ring.names("COR")[4], ring.names("COR")[90]
    its = EffectSettings(
        id="bpm-row", names=(ring.names("BPM")[7],),
        elements={f"{one} (x)": 0.5, f"{other} (x)": -0.25},
    )  # fmt: skip
    path = tmp_path / "effect.toml"
    path.write_text(effects_toml([its]))
    assert read_effects(path) == (its,)
    layout = layout_of(ring, "x", 0.1)
    change = measured_response(layout, [its], 1) - layout.response
    expected = np.zeros_like(change)
    expected[7, 4], expected[7, 90] = 0.5, -0.25
    np.testing.assert_allclose(change, expected, atol=1e-9)


def test_a_drawn_row_is_off_by_the_share_that_is_asked_for(ring):
    layout = layout_of(ring, "x", 0.1)
    its = parse_effect(f"bpm-row:share=20%,names={ring.names('BPM')[7]}")
    change = measured_response(layout, [its], 1) - layout.response
    share = np.linalg.norm(change[7]) / np.linalg.norm(layout.response[7])
    assert share == pytest.approx(0.2)
    np.testing.assert_allclose(np.delete(change, 7, axis=0), 0.0, atol=1e-9)


def test_elements_are_refused_where_they_mean_nothing(ring):
    layout = layout_of(ring, "x", 0.1)
    with pytest.raises(ValueError, match="corrector-gain does not act on single elements"):
        EffectSettings(id="corrector-gain", elements={"CL1A_C01 (x)": 0.5})
    stranger = EffectSettings(id="bpm-row", elements={"CL1A_C1 (x)": 0.5})
    with pytest.raises(ConfigError, match=r"no CL1A_C1 \(x\) in this ring .*did you mean"):
        build([stranger], layout, 1)
