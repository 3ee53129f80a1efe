"""What a training stands on: a response, its posterior, the operation that it was taken from."""

from dataclasses import dataclass

from orbitfb.app.setup.stored_policies import open_store
from orbitfb.app.train.request import NOMINAL, TrainingRequest
from orbitfb.config.tree import AppConfig
from orbitfb.core.errors import EstimationError
from orbitfb.core.signals import Channels, Vector
from orbitfb.core.transitions import Transitions
from orbitfb.effects.build import layout_of, measured_response
from orbitfb.history.archive import read_archive
from orbitfb.measure.response_file import nominal_response
from orbitfb.models.identify import Identifier
from orbitfb.models.linear import LinearModel
from orbitfb.models.rows import select_rows
from orbitfb.policies.store.kinds import StoredPolicy


@dataclass(frozen=True, slots=True)
class Ground:
    """What a training stands on.

    Args:
        channels: Of the ring.
        response: R, shape (n, m) [m/A].
        start: The stored policy that it begins from; None: the optics.
        posterior: What the archive says about R; None without one.
        transitions: The archive; None without one.
    """

    channels: Channels
    response: Vector
    start: StoredPolicy | None
    posterior: LinearModel | None
    transitions: Transitions | None


def find_ground(config: AppConfig, request: TrainingRequest) -> Ground:
    """Read what is named.

    Raises:
        ConfigError: An effect is to be where nothing is.
        StoreError: There is no such policy, or it is of another ring.
        ArchiveError: The archive cannot be read, or is of another ring.
        EstimationError: The response cannot be identified from it.
    """
    ring = config.ring.load()
    channels = ring.channels(config.ring.planes)
    start: StoredPolicy | None = None
    if request.start == NOMINAL:
        matrix = nominal_response(ring, config.ring.planes, config.ring.response, config.masks)
        if config.effect:
            layout = layout_of(ring, config.ring.planes, config.loop.period, matrix)
            matrix = measured_response(layout, config.effect, config.seed)
    else:
        start = open_store(config).load(request.start, channels)
        matrix = start.response
    if request.archive is None:
        return Ground(channels, matrix, start, None, None)
    transitions = read_archive(request.archive, channels)
    if request.method == "supervised":  # it takes the answers, whatever they did
        return Ground(channels, matrix, start, None, transitions)
    identifier = Identifier(matrix, config.learn.identify)
    identifier.absorb(select_rows(transitions, config.learn.tolerance))
    if identifier.last_tick is None:
        raise EstimationError(
            f"no transition of {request.archive} can be used to identify the response; record "
            "with the loop CLOSED and readbacks that follow the setpoints"
        )
    posterior = identifier.model
    return Ground(channels, posterior.response, start, posterior, transitions)
