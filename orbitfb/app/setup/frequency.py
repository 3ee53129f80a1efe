"""Whether the RF frequency follows, and what it takes."""

from collections.abc import Callable

from orbitfb.app.setup.startup import SIMULATED
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import RingError
from orbitfb.core.names import RF_FREQUENCY, RF_READBACK
from orbitfb.core.ports import Oscillator
from orbitfb.core.transitions import Transitions
from orbitfb.epics.settings import AuxiliarySettings, EpicsSettings
from orbitfb.estimation.columns import KnownRf
from orbitfb.loop.frequency import Follower
from orbitfb.loop.machines.guarded import GuardedOscillator
from orbitfb.physics.frequency import FrequencyModel, frequency_model
from orbitfb.physics.places import Ring


def rf_model(
    config: AppConfig, ring: Ring, ioc: str, say: Callable[[str], None]
) -> FrequencyModel | None:
    """Say what the frequency does, if the loop is to step it.

    Left out, `rf.enabled` is true for a simulated ring of our own with plane x, and false for every
    other ring: there somebody has to want it.

    Args:
        config: The configuration.
        ring: The ring.
        ioc: Where it is.
        say: Told why the frequency of a simulated ring is left alone.

    Returns:
        The model; None: the frequency is left alone.

    Raises:
        RingError: It is wanted, and the ring is not described so that it could.
    """
    wanted, planes = config.rf.enabled, config.ring.planes
    if wanted is False or (wanted is None and (ioc != SIMULATED or "x" not in planes)):
        return None
    try:
        return frequency_model(ring, planes)
    except RingError as error:
        if wanted:
            raise
        say(f"the RF frequency is not adjusted: {error}")
        return None


def told_rf(model: FrequencyModel | None) -> KnownRf | None:
    """Say what the learner is told of the RF; None: the frequency is left alone."""
    if model is None:
        return None
    return KnownRf(model.response, model.energy / model.per_hertz)


def archived_rf(config: AppConfig, ring: Ring, transitions: Transitions) -> KnownRf | None:
    """Say the same for records, whoever made them; None: the frequency was not stepped in them.

    Args:
        config: Names the planes.
        ring: The ring.
        transitions: That were recorded.

    Raises:
        RingError: It was stepped, and the places table cannot tell what that does.
    """
    if not transitions.hertz.any():
        return None
    return told_rf(frequency_model(ring, config.ring.planes))


def with_rf(epics: EpicsSettings, config: AppConfig) -> EpicsSettings:
    """Let the setpoint of the frequency and its readback be read beside the orbit.

    Args:
        epics: How to reach the machine.
        config: Names the PVs.
    """
    channels = {RF_FREQUENCY: AuxiliarySettings(pv=config.rf.setpoint_pv)}
    if config.rf.readback_pv:
        channels[RF_READBACK] = AuxiliarySettings(pv=config.rf.readback_pv)
    return epics.model_copy(update={"auxiliary": {**epics.auxiliary, **channels}})


def follower_of(
    oscillator: Oscillator | None,
    model: FrequencyModel | None,
    config: AppConfig,
    refusal: Callable[[], str],
) -> Follower | None:
    """Make what steps the frequency; None: it is left alone.

    Args:
        oscillator: The RF; None: there is none.
        model: What it does; None: it is left alone.
        config: Has the limits.
        refusal: Says why the machine must not be written to now; empty when it may.
    """
    if oscillator is None or model is None:
        return None
    guarded = GuardedOscillator(oscillator, refusal)
    noise = config.learn.identify.reading_noise
    return Follower(guarded, model, config.rf, noise, config.loop.ramp)
