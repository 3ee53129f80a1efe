"""A lease that a machine did not have when the service began: taken once it is there."""

from collections.abc import Callable, Sequence

from orbitfb.core.errors import MachineError, OwnershipError
from orbitfb.core.ports import Clock
from orbitfb.epics.lease.lease import Board, Lease, LeaseSettings, Sign


class LateLease(Lease):
    """Looks for the lease at every sign of life, and takes it or gives the machine up.

    As long as there is none the machine may be written to. From the moment it appears until it is
    known whose it is, it may not: somebody else may hold it.

    Args:
        board: Where it is written.
        settings: Its time.
        clock: Monotonic.
        wait: Waits so long [s]; True: give up.
        lost: Told who holds it, once.
        missing: Tells which of its PVs are not there.
        taken: Told whose stale lease it was when it is ours; empty when it was free.
    """

    def __init__(
        self,
        board: Board,
        settings: LeaseSettings,
        clock: Clock,
        wait: Callable[[float], bool],
        lost: Callable[[str], None],
        missing: Callable[[], Sequence[str]],
        taken: Callable[[str], None] = lambda _: None,
    ) -> None:
        super().__init__(board, settings, clock, wait, lost)
        self._missing, self._taken = missing, taken
        self._here = self._ours = False

    @property
    def owner(self) -> str:
        """Who holds it, as far as is known; empty while there is none."""
        return super().owner if self._ours or self._taken_by else ""

    def beat(self) -> None:
        """Give a sign of life; before that, look whether there is a lease by now."""
        if self._ours or self._taken_by:
            super().beat()
            return
        self._here = not self._missing()
        if not self._here:
            return
        try:
            before = self.take()
        except OwnershipError:
            self._find_owner()
        except MachineError as error:
            self.trouble = str(error)
        else:
            self._ours = True
            self._taken(before)

    def refusal(self) -> str:
        """Say why the machine must not be written to now; empty when it may."""
        if self._ours or self._taken_by:
            return super().refusal()
        return "the lease of the machine has appeared; who holds it is being asked" * self._here

    def release(self) -> None:
        """Give it back if it is ours."""
        if self._ours:
            super().release()

    def _find_owner(self) -> None:
        """Give the machine up to who holds it, unless the service ends or they let go."""
        if self._wait(0.0):
            return
        try:
            texts = self._board.read()
        except MachineError as error:  # it is asked again at the next sign of life
            self.trouble = str(error)
            return
        if self._sign(texts) is Sign.THEIRS:
            self._give_up(texts)
