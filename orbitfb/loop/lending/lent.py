"""What the borrower holds: a machine each of whose calls is carried out in the loop's thread."""

from concurrent.futures import Future
from dataclasses import dataclass, field
from queue import SimpleQueue

from orbitfb.core.errors import MachineError
from orbitfb.core.signals import Applied, Channels, Mask, Reading, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Read:
    """The borrower waits for the next orbit."""

    answer: Future[Reading] = field(default_factory=Future[Reading])


@dataclass(frozen=True, slots=True, eq=False)
class Ask:
    """The borrower asks for the setpoints in force."""

    answer: Future[Vector] = field(default_factory=Future[Vector])


@dataclass(frozen=True, slots=True, eq=False)
class Write:
    """The borrower wants setpoints written.

    Args:
        setpoints: Shape (m,) [A].
        which: Correctors to put, shape (m,).
    """

    setpoints: Vector
    which: Mask
    answer: Future[Applied] = field(default_factory=Future[Applied])


@dataclass(frozen=True, slots=True, eq=False)
class Leave:
    """The borrower needs the machine no longer."""

    answer: Future[None] = field(default_factory=Future[None])


Request = Read | Ask | Write | Leave


@dataclass(slots=True, eq=False)
class Loan:
    """A machine that is lent.

    Args:
        name: What it is lent for.
        lent: Correctors that may be written, shape (m,).
        requests: What the borrower asks for.
        waiting: A read that the next orbit answers.
        deferred: A write that has to wait for the next tick.
        trouble: Why the borrower has to give the machine back; empty: it may go on.
        told: Whether it knows.
        calls: What it has asked for so far.
        over: Whether the loop serves it no longer.
    """

    name: str
    lent: Mask
    requests: SimpleQueue[Request] = field(default_factory=SimpleQueue[Request])
    waiting: Read | None = None
    deferred: Write | None = None
    trouble: str = ""
    told: bool = False
    calls: int = 0
    over: bool = False

    def call_back(self, reason: str) -> None:
        """Tell the borrower at its next call that it has to put back what it moved."""
        self.trouble = self.trouble or reason

    def tell(self) -> MachineError | None:
        """Give what the borrower must be told now; None: nothing."""
        if not self.trouble or self.told:
            return None
        self.told = True
        return MachineError(self.trouble)

    def refuse(self) -> None:
        """Refuse all that was asked for and is not answered: the loan is over."""
        left: list[Request | None] = [self.waiting, self.deferred]
        self.waiting = self.deferred = None
        while not self.requests.empty():
            left.append(self.requests.get())
        for request in filter(None, left):
            request.answer.set_exception(MachineError(self.trouble or f"{self.name} is over"))


class LentMachine:
    """A `Machine` for one other thread. The loop answers every call, at its ticks.

    Args:
        channels: Names behind the elements of the vectors.
        loan: What the loop knows of it.

    Attributes:
        orbits: How many have been given out.
    """

    def __init__(self, channels: Channels, loan: Loan) -> None:
        self._channels, self._loan = channels, loan
        self.orbits = 0

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        return self._channels

    def read(self, timeout: float) -> Reading:
        """Wait for the next coherent orbit; the loop says when none comes.

        Args:
            timeout: Of no effect: the loop has its own.

        Raises:
            NoOrbitError: None came in a tick, or none that may be acted on.
            MachineError: The loop calls the machine back, once: what was moved is to be put back.
        """
        request = Read()
        self._put(request)
        reading = request.answer.result()
        self.orbits += 1
        return reading

    def setpoints(self) -> Vector:
        """Ask the machine for the absolute setpoints in force, shape (m,) [A]."""
        request = Ask()
        self._put(request)
        return request.answer.result()

    def write(self, setpoints: Vector, which: Mask | None = None) -> Applied:
        """Send absolute setpoints; no corrector is put twice between two orbits.

        Args:
            setpoints: Shape (m,) [A].
            which: Correctors to put, shape (m,); None: all that are lent.

        Raises:
            WriteError: The machine, a limit or the loop refuses.
            MachineError: The loop calls the machine back; see `read`.
        """
        request = Write(setpoints, self._loan.lent if which is None else which)
        self._put(request)
        return request.answer.result()

    def close(self) -> None:
        """Give the machine back; setpoints stay where they are."""
        if not self._loan.over:
            request = Leave()
            self._put(request)
            request.answer.result()

    def _put(self, request: Request) -> None:
        self._loan.requests.put(request)
        if self._loan.over:  # it may have ended before it could see the request
            self._loan.refuse()
