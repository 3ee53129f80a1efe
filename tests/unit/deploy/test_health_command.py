"""`orbitfb health`: what it makes of answers, good, bad and of somebody else; no sockets."""

import http.client
import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from orbitfb.cli.app import app
from orbitfb.core.errors import ConfigError

GOOD = {"good": True, "reason": "", "state": "CLOSED", "last_tick_age_s": 0.1, "ticks": 7}


class Reply:
    """An answer of a server."""

    def __init__(self, status: int, content: bytes) -> None:
        self.status, self._content = status, content

    def read(self, most: int) -> bytes:
        return self._content[:most]


@pytest.fixture
def answering(monkeypatch: pytest.MonkeyPatch):
    """Answer every request; gives what was asked for."""
    asked: list[tuple[str, int, str, float]] = []

    def answer(reply: Reply | Exception) -> list[tuple[str, int, str, float]]:
        class Connection:
            def __init__(self, host: str, port: int, timeout: float) -> None:
                self._where = (host, port, timeout)

            def request(self, method: str, path: str, headers: dict[str, str]) -> None:
                assert method == "GET"
                host, port, timeout = self._where
                asked.append((host, port, path, timeout))
                if isinstance(reply, Exception):
                    raise reply

            def getresponse(self) -> Reply | Exception:
                return reply

            def close(self) -> None:
                pass

        monkeypatch.setattr(http.client, "HTTPConnection", Connection)
        return asked

    return answer


def run(*options: str) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["health", *options])
    if isinstance(done.exception, ConfigError):
        raise done.exception
    return done.exit_code, done.output.strip()


def test_it_is_alive(answering):
    asked = answering(Reply(200, json.dumps(GOOD).encode()))
    assert run("--host", "::1", "--port", "9") == (0, "alive: CLOSED, last tick 0.10 s ago")
    assert run("--timeout", "1.5", "--ready") == (0, "ready: CLOSED, last tick 0.10 s ago")
    assert asked == [("::1", 9, "/healthz", 3.0), ("127.0.0.1", 9180, "/readyz", 1.5)]


def test_it_is_alive_before_its_first_tick(answering):
    answering(Reply(200, json.dumps({**GOOD, "state": None, "last_tick_age_s": 0.2}).encode()))
    assert run("--port", "9") == (0, "alive: no tick yet")


def test_the_configuration_says_where(answering, tmp_path: Path):
    asked = answering(Reply(200, json.dumps(GOOD).encode()))
    config = tmp_path / "orbitfb.toml"
    config.write_text('[observe]\nhost = "0.0.0.0"\nport = 1234\n')
    assert run("--config", str(config))[0] == 0
    assert asked[0][:2] == ("127.0.0.1", 1234)


@pytest.mark.parametrize(
    ("status", "content", "said"),
    [
        (503, json.dumps({**GOOD, "good": False, "reason": "FAULT: x"}), "not alive: FAULT: x"),
        (503, json.dumps(GOOD), "not alive: CLOSED"),
        (200, "<html>hello</html>", "is not orbitfb"),
        (200, '{"status": "UP"}', "is not orbitfb"),
        (200, '{"good": "yes"}', "is not orbitfb"),
        (200, "[" * 30_000, "is not orbitfb"),
        (302, "", "is not orbitfb"),
        (200, '{"good": true, "reason": "' + "x" * 100_000, "is not orbitfb"),
    ],
)
def test_it_is_not(answering, status: int, content: str, said: str):
    answering(Reply(status, content.encode()))
    code, told = run("--port", "9")
    assert code == 1 and said in told


@pytest.mark.parametrize(
    "error",
    [ConnectionRefusedError("refused"), TimeoutError(), http.client.BadStatusLine("SSH-2.0")],
)
def test_nobody_answers(answering, error: Exception):
    answering(error)
    code, told = run("--host", "nowhere", "--port", "9")
    assert code == 1 and told.startswith("not alive: no answer from nowhere port 9")
    assert json.loads(run("--port", "9", "--json")[1])["good"] is False


@pytest.mark.parametrize(
    ("text", "message"),
    [("port = 0", "any free port"), ("enabled = false", "nobody answers")],
)
def test_a_configuration_that_says_nothing(tmp_path: Path, text: str, message: str):
    config = tmp_path / "orbitfb.toml"
    config.write_text(f"[observe]\n{text}\n")
    with pytest.raises(ConfigError, match=message):
        run("--config", str(config))
