"""How the channels and the recorder of post-mortems are doing: words that metrics share."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ChannelCounts:
    """Channels of one kind.

    Args:
        kind: `bpm`, `setpoint`, `readback` or `auxiliary`.
        channels: How many there are.
        connected: How many of them answer now.
        losses: How often one went away since the start.
    """

    kind: str
    channels: int
    connected: int
    losses: int


@dataclass(frozen=True, slots=True)
class PostMortemStatus:
    """What became of the post-mortems since the start.

    Args:
        written: Files written.
        failed: Post-mortems that could not be written, or had to be given up.
        waiting: Frozen, not yet on disk.
        last: Name of the file written last; empty before the first.
        problem: Why the last one could not be written; empty when all is well.
    """

    written: int
    failed: int
    waiting: int
    last: str
    problem: str
