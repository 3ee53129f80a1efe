"""The ports: what the loop needs of a machine, of a policy, of a clock, of its listeners."""

from typing import Any, Protocol

from orbitfb.core.signals import Applied, Channels, Mask, Reading, TickRecord, Vector


class Machine(Protocol):
    """A storage ring behind its BPMs and correctors."""

    @property
    def channels(self) -> Channels:
        """Names behind the elements of the vectors."""
        ...

    def read(self, timeout: float) -> Reading:
        """Wait for the next coherent orbit, never one that was returned before.

        Args:
            timeout: How long to wait [s].

        Raises:
            NoOrbitError: None came in time; the message says what was missing.
        """
        ...

    def setpoints(self) -> Vector:
        """Ask the machine for the absolute setpoints in force, shape (m,) [A].

        Raises:
            MachineError: A setpoint cannot be read; the message says how many, and which.
            AwayError: The same, where the others could be.
        """
        ...

    def write(self, setpoints: Vector, which: Mask | None = None) -> Applied:
        """Send absolute setpoints: all that are asked for, or none.

        Args:
            setpoints: Shape (m,) [A]; elements that are not asked for are not looked at.
            which: Correctors to put, shape (m,); None: all. Others are left alone, whoever moved
                them, be they away or switched off.

        Raises:
            WriteError: One of them is away or refuses, or its value is not finite.
        """
        ...

    def close(self) -> None:
        """Let go of the machine; setpoints stay where they are."""
        ...


class Oscillator(Protocol):
    """The RF of a ring, whose frequency can be set; the machine reads it as a slow channel."""

    @property
    def limits(self) -> tuple[float, float]:
        """Drive limits that the machine states, low and high [Hz]; NaN: none."""
        ...

    def put(self, frequency: float) -> None:
        """Send a setpoint [Hz].

        Raises:
            WriteError: It is away or read-only; nothing was sent.
        """
        ...


class Policy(Protocol):
    """A law from orbit error to a change of the setpoints."""

    @property
    def policy_id(self) -> str:
        """Name under which the store and every record know it."""
        ...

    def initial_state(self) -> Any:
        """State to begin with: whatever `act` carries from tick to tick."""
        ...

    def act(self, error: Vector, valid: Mask, state: Any) -> tuple[Vector, Any]:
        """Decide.

        Args:
            error: Orbit − reference, shape (n,) [m]; finite where valid, ignored elsewhere.
            valid: BPMs that count, shape (n,).
            state: What the last call returned, or `initial_state()`.

        Returns:
            The change of setpoints, shape (m,) [A], and the new state.
        """
        ...


class Learning(Policy, Protocol):
    """A policy that learns from what was read and sent; optional, the loop asks whether it is."""

    def inform(
        self, error: Vector, valid: Mask, applied: Vector, state: Any, hertz: float = 0.0
    ) -> Any:
        """Take in what came of a decision, after the write.

        Args:
            error: Orbit − reference that was decided on, shape (n,) [m].
            valid: BPMs that count, shape (n,).
            applied: Change of setpoints as it was sent, shape (m,) [A].
            state: What `act` was given.
            hertz: Step of the RF frequency that went with it [Hz]; given only to a policy that
                has `learns_rf`. For any other one, what goes with a step is no part of `applied`.

        Returns:
            The state for the next call.
        """
        ...

    def take_back(self) -> None:
        """Forget what was learnt of late: the loop has tripped, maybe by that."""
        ...


def inform(
    policy: Policy,
    error: Vector,
    valid: Mask,
    applied: Vector,
    state: Any,
    hertz: float = 0.0,
) -> Any:
    """Tell a policy that learns what came of its decision, see `Learning.inform`.

    Returns:
        The state for the next decision; as it was, where the policy does not learn.
    """
    learning = getattr(policy, "inform", None)
    if learning is None:
        return state
    more = {"hertz": hertz} if hertz else {}
    return learning(error, valid, applied, state, **more)


def take_back(policy: Policy) -> None:
    """Tell a policy that learns that the loop has tripped, see `Learning.take_back`."""
    getattr(policy, "take_back", lambda: None)()


class SystemModel(Protocol):
    """A model of the ring: s' = f(s, a)."""

    def predict(self, orbit: Vector, change: Vector) -> Vector:
        """Predict the next orbit, shape (n,) [m], from an orbit [m] and a change (m,) [A]."""
        ...


class Clock(Protocol):
    """The two clocks that the loop reads."""

    def wall(self) -> float:
        """Now [s since the epoch]."""
        ...

    def monotonic(self) -> float:
        """Now on a clock that never steps [s]."""
        ...


class Subscriber(Protocol):
    """Gets every record. It must return at once and never raise."""

    def __call__(self, record: TickRecord) -> None:
        """Take a record."""
        ...
