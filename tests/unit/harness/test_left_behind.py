"""What tests leave behind is noticed."""

import socket

import pytest
from left_behind import listeners, watch


def test_a_port_is_listened_on_until_it_is_closed():
    before = listeners()
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_server(("127.0.0.1", 0)):
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)):
            assert f"listening port {port}" in listeners()
            assert len(listeners() - before) == 2
    assert listeners() == before


def test_a_port_that_is_left_fails_the_test(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("left_behind.PATIENCE", 0.0)
    watching = watch()
    next(watching)
    with socket.create_server(("127.0.0.1", 0)) as server:
        left = rf"left behind: listening port {server.getsockname()[1]}"
        with pytest.raises(pytest.fail.Exception, match=left):
            next(watching)
