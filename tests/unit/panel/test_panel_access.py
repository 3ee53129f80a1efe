"""Who may write what from where."""

from pathlib import Path

import pytest

from orbitfb.core.errors import ConfigError
from orbitfb.panel.access import default_access, read_access

NAMES = ("Command-Cmd", "Reset-Cmd", "GainX-SP", "GainY-SP")


def access(tmp_path: Path, text: str):
    file = tmp_path / "rules.toml"
    file.write_text(text)
    return read_access(file, "127.0.0.1", NAMES)


@pytest.mark.parametrize(
    ("address", "allowed"),
    [
        ("127.0.0.1", True),
        ("127.3.2.1", True),
        ("10.0.0.5", True),  # the address on which the panel listens is of its own host
        ("10.0.0.6", False),
        ("", False),
        ("localhost", False),  # what a client claims is no address
    ],
)
def test_by_default_the_own_host_writes_and_the_others_read(address: str, allowed: bool):
    assert default_access("10.0.0.5").may_write("GainX-SP", "anybody", address) is allowed


def test_a_rule_says_who_writes_what_from_where(tmp_path: Path):
    rules = access(
        tmp_path,
        """
        [[rule]]
        pvs = ["Gain*"]
        users = ["ops*", "jane"]
        hosts = ["10.0.5.0/24", "192.168.1.7"]

        [[rule]]
        pvs = ["Reset-Cmd"]
        """,
    )
    assert rules.may_write("GainX-SP", "ops3", "10.0.5.99")
    assert rules.may_write("GainY-SP", "jane", "192.168.1.7")
    assert not rules.may_write("GainX-SP", "john", "10.0.5.99")
    assert not rules.may_write("GainX-SP", "ops3", "10.0.6.1")
    assert not rules.may_write("Command-Cmd", "ops3", "10.0.5.99")
    assert not rules.may_write("GainX-SP", "ops3", "127.0.0.1")  # the default is gone
    assert rules.may_write("Reset-Cmd", "anybody", "127.0.0.1")
    assert not rules.may_write("Reset-Cmd", "anybody", "10.0.5.99")


def test_no_rule_allows_nothing(tmp_path: Path):
    assert not access(tmp_path, "").may_write("GainX-SP", "root", "127.0.0.1")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[rule]]\n", r"rule.0.pvs: Field required"),
        ("[[rule]]\npvs = []\n", r"rule.0.pvs: Tuple should have at least 1 item"),
        ('[[rule]]\npvs = ["*"]\nhost = ["x"]\n', r"rule.0.host: Extra inputs"),
        ('[[rule]]\npvs = ["Gian*"]\n', r"'Gian\*' fits no PV .* Command-Cmd, Reset-Cmd, GainX"),
        ('[[rule]]\npvs = ["*"]\nhosts = ["10.0.5.1/24"]\n', r"host '10.0.5.1/24' is not known"),
        ("[[rule]\n", "is not TOML"),
        ("\ufffe", "is not TOML"),
    ],
)
def test_a_wrong_rule_is_refused_with_its_place(tmp_path: Path, text: str, message: str):
    with pytest.raises(ConfigError, match=message) as caught:
        access(tmp_path, text)
    assert str(tmp_path / "rules.toml") in str(caught.value)


def test_a_file_that_is_not_there_or_too_long(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"none.toml: cannot be read \(No such file"):
        read_access(tmp_path / "none.toml", "127.0.0.1", NAMES)
    with pytest.raises(ConfigError, match="is longer than 1048576 bytes"):
        access(tmp_path, "#" * (1 << 20) + "\n")
