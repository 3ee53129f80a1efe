import itertools

import pytest

from orbitfb.core.errors import ControlError
from orbitfb.core.signals import LoopState
from orbitfb.loop.states import COMMANDS, TABLE, Event, as_command, next_state

N, S, C, H, T, F = (  # N: open
    LoopState(name) for name in ("OPEN", "SHADOW", "CLOSED", "HELD", "TRIPPED", "FAULT")
)
# open shadow close reset | missing hold trip recovered too_long fault; None = refused
EXPECTED = {
    N: (N, S, C, None, N, N, N, N, N, F),
    S: (N, S, C, None, S, S, S, S, S, F),
    C: (N, S, C, None, H, H, T, C, C, F),
    H: (N, S, C, None, H, H, T, C, T, F),
    T: (None, None, None, N, T, T, T, T, T, F),
    F: (None, None, None, None, F, F, F, F, F, F),
}


@pytest.mark.parametrize(("state", "event"), list(itertools.product(LoopState, Event)))
def test_every_pair(state, event):
    expected = EXPECTED[state][list(Event).index(event)]
    if expected is None:
        assert event in COMMANDS
        with pytest.raises(ControlError, match=f"{event} refused in {state}: .+"):
            next_state(state, event)
    else:
        assert next_state(state, event) is expected


def test_latched_states_leave_only_as_they_should():
    assert {e for e, after in TABLE[T].items() if after is not T} == {Event.RESET, Event.FAULT}
    assert all(after is F for after in TABLE[F].values())


@pytest.mark.parametrize("name", ["", "trip", "CLOSE", "fault"])
def test_only_commands_are_commands(name):
    with pytest.raises(ControlError, match="the loop knows open, shadow, close, reset"):
        as_command(name)
