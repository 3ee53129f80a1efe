"""How the channels to the machine are doing: the word that epics and metrics share."""

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
