"""The simulated ring as an environment of gymnasium, `orbitfb/OrbitFeedback-v0`.

An episode is a ring of its own, drawn from the seed: a new first orbit, new noise, new drift. One
step is one tick: the action changes the setpoints, and the next orbit is observed. The reward is
minus the rms of the true orbit, which only a simulated ring knows, in units of `orbit_scale`.

Needs the extra `rl`.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from pydantic import ValidationError

from orbitfb.core.errors import ConfigError
from orbitfb.core.signals import Vector
from orbitfb.effects.build import plant_with
from orbitfb.effects.settings import EffectSettings, parse_effect
from orbitfb.gym.scaling import CLIP, Coordinates, Numbers, Scaling
from orbitfb.physics.places import Planes, Ring
from orbitfb.physics.plant import Plant, PlantSettings
from orbitfb.physics.response import response

LOST = 5e-3
"""True orbit at which an episode ends: the beam is lost, rms [m]."""

PENALTY = 100.0
"""What a lost beam costs, so that no agent ends an episode to be spared the rest of it [1]."""

LIMIT = 18.0
"""Drive limit of every setpoint, either sign [A]."""


class OrbitFeedbackEnv(gymnasium.Env[Numbers, Numbers]):
    """A ring whose orbit is to be kept at zero.

    Observation: Box(−50, 50), the readings along the modes of the known R (or per BPM), divided by
    `orbit_scale`. Action: Box(−1, 1), the change of the setpoints along the same modes (or per
    corrector); an action of 1 takes 3 `orbit_scale` away along its mode.

    Args:
        planes: `x`, `y` or `xy`.
        plant: What the ring suffers from; settings, or a mapping of some of them.
        effects: Effects that it has besides, settings or texts as for `--effect`.
        coordinates: `modes` or `devices`.
        modes: The strongest modes that are seen and moved; None: all of them.
        orbit_scale: Orbit that counts as 1, rms [m]; None: the first orbit of the plant.
        period: By which effects count time [s].
        places: Table of places (CSV); None: the default ring.
        parameters: Parameters of the ring (JSON); None: the default ring.
        render_mode: Only None: there is nothing to see.

    Raises:
        ConfigError: A setting is wrong.
    """

    metadata = {"render_modes": []}  # noqa: RUF012  gymnasium's own way

    def __init__(
        self,
        planes: Planes = "x",
        plant: PlantSettings | Mapping[str, Any] | None = None,
        effects: Sequence[EffectSettings | str] = (),
        coordinates: Coordinates = "modes",
        modes: int | None = None,
        orbit_scale: float | None = None,
        period: float = 0.1,
        places: Path | str | None = None,
        parameters: Path | str | None = None,
        render_mode: str | None = None,
    ) -> None:
        if render_mode is not None:
            raise ConfigError(f"render_mode {render_mode!r}: there is nothing to see; leave it out")
        if planes not in ("x", "y", "xy"):
            raise ConfigError(f"planes {planes!r}: choose x, y or xy")
        self._planes: Planes = planes
        self._period = period
        self._settings = _plant_settings(plant)
        self._effects = tuple(
            parse_effect(each) if isinstance(each, str) else each for each in effects
        )
        self._ring = Ring.load(_path(places), _path(parameters))
        nominal = response(self._ring, planes)
        usual = self._settings.initial_orbit_rms or 1e-6
        scale = usual if orbit_scale is None else orbit_scale
        self.render_mode = render_mode
        self.scaling = Scaling.of(nominal, coordinates, scale, modes)
        seen, moved = len(self.scaling.view), self.scaling.move.shape[1]
        self.observation_space = gymnasium.spaces.Box(-CLIP, CLIP, (seen,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (moved,), np.float32)
        self._setpoints: Vector = np.zeros(nominal.shape[1])
        self._plant: Plant | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Numbers, dict[str, Any]]:
        """Begin an episode.

        Args:
            seed: Of this and the following episodes.
            options: `plant_seed` draws that very ring, the one of `policies compare` with it.

        Returns:
            The first observation and the figures of the tick.

        Raises:
            ConfigError: There is no such option.
        """
        if unknown := set(options or {}) - {"plant_seed"}:
            raise ConfigError(f"options {', '.join(sorted(unknown))}: only plant_seed is known")
        super().reset(seed=seed)
        drawn = int(self.np_random.integers(2**31))
        plant_seed = int((options or {}).get("plant_seed", drawn))
        self._plant = plant_with(
            self._ring, self._planes, self._settings, plant_seed, self._effects, self._period
        )
        self._setpoints = np.zeros_like(self._setpoints)
        observation, true = self._tick()
        return observation, self._figures(true, plant_seed=plant_seed)

    def step(self, action: Numbers) -> tuple[Numbers, float, bool, bool, dict[str, Any]]:
        """Change the setpoints and let a tick pass.

        Raises:
            ConfigError: No episode has begun, or the action is not finite or of another shape.
        """
        if self._plant is None:
            raise ConfigError("no episode has begun; call reset first")
        action = np.asarray(action)
        if action.shape != self.action_space.shape:
            raise ConfigError(
                f"an action of shape {action.shape}; give one of shape {self.action_space.shape}"
            )
        if not np.isfinite(action).all():
            count = int(np.count_nonzero(~np.isfinite(action)))
            raise ConfigError(f"{count} values of the action are not finite; give finite ones")
        wanted = self._setpoints + self.scaling.change(action)
        self._setpoints = np.clip(wanted, -LIMIT, LIMIT)
        observation, true = self._tick()
        lost = true > LOST
        reward = -min(true / self.scaling.scale, LOST / self.scaling.scale)
        figures = self._figures(true, limited=bool((self._setpoints != wanted).any()))
        return observation, reward - PENALTY * lost, lost, False, figures

    def _tick(self) -> tuple[Numbers, float]:
        if self._plant is None:
            raise ConfigError("no episode has begun; call reset first")
        state = self._plant.step(self._setpoints)
        self._observed = float(np.sqrt(np.mean(state.reading**2)))
        true = float(np.sqrt(np.mean(state.true_orbit**2)))
        return self.scaling.see(state.reading), true

    def _figures(self, true: float, **more: Any) -> dict[str, Any]:
        return {"true_rms": true, "observed_rms": self._observed, **more}


def _plant_settings(plant: PlantSettings | Mapping[str, Any] | None) -> PlantSettings:
    if isinstance(plant, PlantSettings):
        return plant
    try:
        return PlantSettings.model_validate(dict(plant or {}))
    except ValidationError as error:
        problems = "; ".join(
            f"plant.{'.'.join(map(str, each['loc']))}: {each['msg']}" for each in error.errors()
        )
        raise ConfigError(problems) from None


def _path(path: Path | str | None) -> Path | None:
    return None if path is None else Path(path)
