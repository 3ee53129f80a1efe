"""Who may write which PV of the panel, from where.

Rules are read from a TOML file, one table `rule` each:

    [[rule]]
    pvs = ["Command-Cmd", "Gain*"]     # names without the prefix; * and ? as in file names
    users = ["operator"]               # left out: anybody
    hosts = ["10.0.5.0/24", "cr-ws1"]  # addresses, networks or names; left out: the own host

A write is allowed if one rule allows it. Reading is always allowed. A host is known by the
address that its connection comes from, not by the name that it claims; a user is known only by
what the client claims, as everywhere in Channel Access, so that a rule for users keeps honest
people from mistakes and nobody else out.
"""

import ipaddress
import socket
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from pydantic import Field, ValidationError

from orbitfb.core.errors import ConfigError
from orbitfb.core.files.bounded import parse_toml, read_text
from orbitfb.core.settings import Settings

Network = ipaddress.IPv4Network | ipaddress.IPv6Network

OWN = ipaddress.ip_network("127.0.0.0/8")
LARGEST_FILE = 1 << 20
"""Longest file of rules that is read [bytes]."""


@dataclass(frozen=True, slots=True)
class Rule:
    """One permission to write.

    Args:
        pvs: Patterns of names without the prefix.
        users: Patterns of user names.
        networks: Where from.
    """

    pvs: tuple[str, ...]
    users: tuple[str, ...]
    networks: tuple[Network, ...]

    def allows(self, pv: str, user: str, address: str) -> bool:
        """Say whether it allows a write.

        Args:
            pv: Name without the prefix.
            user: As the client claims.
            address: Where the connection comes from.
        """
        try:
            place = ipaddress.ip_address(address)
        except ValueError:
            return False
        return (
            any(fnmatchcase(pv, pattern) for pattern in self.pvs)
            and any(fnmatchcase(user, pattern) for pattern in self.users)
            and any(place in network for network in self.networks)
        )


@dataclass(frozen=True, slots=True)
class Access:
    """All rules.

    Args:
        rules: One suffices for a write.
    """

    rules: tuple[Rule, ...]

    def may_write(self, pv: str, user: str, address: str) -> bool:
        """Say whether a user may write a PV, name without prefix, from an address."""
        return any(rule.allows(pv, user, address) for rule in self.rules)


class _RuleText(Settings):
    pvs: tuple[str, ...] = Field(min_length=1)
    users: tuple[str, ...] = Field(default=("*",), min_length=1)
    hosts: tuple[str, ...] | None = Field(default=None, min_length=1)


class _RulesText(Settings):
    rule: tuple[_RuleText, ...] = ()


def default_access(interface: str) -> Access:
    """Let whoever is on this host write everything.

    Args:
        interface: Where the panel listens: an address of this host.
    """
    return Access((Rule(("*",), ("*",), _own_host(interface)),))


def read_access(file: Path | None, interface: str, names: tuple[str, ...]) -> Access:
    """Read the rules.

    Args:
        file: Where they are; None: the default.
        interface: Where the panel listens.
        names: PVs that can be written, without prefix: a pattern must fit one of them.

    Raises:
        ConfigError: The file cannot be read, a rule is wrong, fits no PV, or names a host that
            is not known.
    """
    if file is None:
        return default_access(interface)
    content = read_text(file, LARGEST_FILE, ConfigError, "see panel.rules")
    try:
        text = _RulesText.model_validate(parse_toml(content, file, ConfigError))
    except ValidationError as error:
        problems = "; ".join(
            f"{'.'.join(map(str, problem['loc']))}: {problem['msg']}" for problem in error.errors()
        )
        raise ConfigError(
            f"{file}: {problems}; each table [[rule]] has pvs, users, hosts"
        ) from None
    return Access(tuple(_rule(rule, file, interface, names) for rule in text.rule))


def _rule(text: _RuleText, file: Path, interface: str, names: tuple[str, ...]) -> Rule:
    for pattern in text.pvs:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise ConfigError(
                f"{file}: the pattern {pattern!r} fits no PV that can be written; those are "
                f"{', '.join(names)}"
            )
    if text.hosts is None:
        return Rule(text.pvs, text.users, _own_host(interface))
    return Rule(text.pvs, text.users, tuple(_network(host, file) for host in text.hosts))


def _network(host: str, file: Path) -> Network:
    try:
        return ipaddress.ip_network(host)
    except ValueError:
        pass
    try:
        return ipaddress.ip_network(socket.gethostbyname(host))
    except (OSError, UnicodeError):
        raise ConfigError(
            f"{file}: the host {host!r} is not known; give an address, a network as 10.0.5.0/24, "
            "or a name that resolves"
        ) from None


def _own_host(interface: str) -> tuple[Network, ...]:
    try:
        address = ipaddress.ip_network(interface)
    except ValueError:
        return (OWN,)
    return (OWN, address)
