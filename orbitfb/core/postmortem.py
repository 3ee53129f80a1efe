"""How the recorder of post-mortems is doing: the word that recorder, metrics and command share."""

from dataclasses import dataclass


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
