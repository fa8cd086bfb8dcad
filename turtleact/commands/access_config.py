"""Reads the ``--config`` file for access control: TLS, passwords, and what clients may use.

Servers and clients read the same TOML file. If a section is missing, its checks are off. A
relative path is resolved from the folder of the file.

.. code-block:: toml

    [tls]
    ca = "ca.pem"               # the authority that signed the others' certificates
    certificate = "robot.pem"
    key = "robot.key"
    mutual = true               # require a certificate from the others

    [login]
    user = "robot"
    password = "secret"
    users = "users.txt"         # who may connect: one user:password per line

    [access]
    actions = ["/patrol"]       # others may use these names and nothing else
    services = []
    topics = ["/turtle1/pose"]  # topics they may read
    commands = []               # topics they may publish to

Source: Zenoh's manual, "TLS", "User-Password authentication" and "Access Control".
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

import msgspec
from msgspec.structs import replace

from turtleact.errors import UsageError
from turtleact.names import resolve_name

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["AccessConfig", "is_loopback", "mode_of", "read_access_config"]


class Tls(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The certificates and the key in the section ``[tls]`` of a ``--config`` file."""

    ca: str = ""
    certificate: str = ""
    key: str = ""
    mutual: bool = False


class Login(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The user name and passwords in the section ``[login]`` of a ``--config`` file."""

    user: str = ""
    password: str = ""
    users: str = ""


class Access(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The names that others may use, in the section ``[access]`` of a ``--config`` file."""

    actions: tuple[str, ...] = ()
    services: tuple[str, ...] = ()
    topics: tuple[str, ...] = ()
    commands: tuple[str, ...] = ()


class AccessConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The contents of a ``--config`` file.

    Attributes:
        tls: The certificates; None if links are not encrypted.
        login: Users and passwords; None if no password is needed.
        access: The names that others may use; None if they may use everything.
    """

    tls: Tls | None = None
    login: Login | None = None
    access: Access | None = None

    @property
    def keeps_strangers_out(self) -> bool:
        """Whether a server with this configuration checks its clients or restricts their access."""
        asks = self.login is not None and bool(self.login.users)
        return asks or self.access is not None or (self.tls is not None and self.tls.mutual)

    def settings(self) -> dict[str, object]:
        """Return the settings of Zenoh: each path in Zenoh's configuration with its value."""
        found: dict[str, object] = {}
        if self.tls is not None:
            tls = self.tls
            values = {
                "root_ca_certificate": tls.ca,
                "listen_certificate": tls.certificate,
                "listen_private_key": tls.key,
                "connect_certificate": tls.certificate if tls.mutual else "",
                "connect_private_key": tls.key if tls.mutual else "",
                "enable_mtls": tls.mutual,
            }
            found |= {f"transport/link/tls/{key}": each for key, each in values.items() if each}
        if self.login is not None:
            login = self.login
            texts = {
                "user": login.user,
                "password": login.password,
                "dictionary_file": login.users,
            }
            found |= {f"transport/auth/usrpwd/{key}": each for key, each in texts.items() if each}
        if self.access is not None:
            found["access_control"] = _access_control(self.access)
        return found


def read_access_config(path: str) -> AccessConfig:
    """Read a ``--config`` file, and make its paths absolute.

    Raises:
        UsageError: if the file cannot be read, is not TOML, or has invalid values.
    """
    from turtleact.commands.message_text import read_text_file  # imports YAML

    file = Path(path)
    text = read_text_file(path, f"--config {path}")
    try:
        access = msgspec.convert(tomllib.loads(text), AccessConfig)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise UsageError(f"--config {path}: {error}") from None
    return _with_paths(access, file)


def is_loopback(endpoint: str) -> bool:
    """Whether an endpoint, such as ``tcp/127.0.0.1:7447``, can be reached only from this machine.

    >>> is_loopback("tcp/localhost:7447"), is_loopback("tls/[::]:7447")
    (True, False)
    """
    protocol, _, address = endpoint.partition("/")
    if protocol.startswith("unix"):
        return True
    return _LOOPBACK.match(address) is not None


def mode_of(connect: Sequence[str], access: AccessConfig) -> Literal["peer", "client"]:
    """Return whether a command joins a graph as a peer or as a client.

    A command joins as a peer if the router is on this machine and ``access`` has no section
    ``[login]``. Otherwise the command joins as a client. The tools of ROS 2 also join as peers.

    A peer talks to each node directly, so it also sees nodes for which the router has no liveliness
    tokens. A peer cannot reach nodes that ask for a password, or nodes of another machine that
    listen only on that machine's loopback address. A client reaches both sorts of nodes through the
    router.

    Args:
        connect: The endpoints to connect to. An empty list means the router of this machine.
        access: The contents of the ``--config`` file.
    """
    is_near = all(is_loopback(each) for each in connect)
    return "peer" if is_near and access.login is None else "client"


_LOOPBACK: Final = re.compile(r"(localhost|127(\.\d+){3}|\[::1\])(:|$)")


def _with_paths(access: AccessConfig, file: Path) -> AccessConfig:
    """Return ``access`` with absolute paths.

    Raise an error if a file does not exist, or if only one of user and password is given.
    """

    def resolve(name: str, given: str) -> str:
        if not given:
            return ""
        found = (file.parent / given).absolute()
        if not found.is_file():
            raise UsageError(f"--config {file}: {name}: there is no file {found}")
        return str(found)

    tls, login = access.tls, access.login
    if tls is not None:
        files = ("ca", "certificate", "key")
        tls = replace(tls, **{each: resolve(f"tls.{each}", getattr(tls, each)) for each in files})
    if login is not None:
        if bool(login.user) != bool(login.password):
            raise UsageError(f"--config {file}: login: give both user and password, or neither")
        login = replace(login, users=resolve("login.users", login.users))
    return replace(access, tls=tls, login=login)


_DECLARED: Final = [
    "declare_subscriber",
    "declare_queryable",
    "liveliness_token",
    "declare_liveliness_subscriber",
    "liveliness_query",
    "reply",
]
"""The kinds of Zenoh messages that a participant needs to join the graph and answer queries."""

_EVERYTHING: Final = ["**", "@ros2_lv/**", "**/@adv/**"]
"""Expressions that together match every key.

Wildcards do not match the parts of a key that begin with an at sign, so the list names these parts.
"""


def _access_control(access: Access) -> dict[str, object]:
    """Return rules that show other nodes the whole graph but let them use only the listed names."""
    actions = [resolve_name(name)[1:] for name in access.actions]
    used = [f"*/{name}/_action/*/*/*" for name in actions]
    used += [f"*/{resolve_name(name)[1:]}/*/*" for name in access.services]
    read = [f"*/{name}/_action/{topic}/*/*" for name in actions for topic in ("feedback", "status")]
    read += [f"*/{resolve_name(name)[1:]}/*/*" for name in access.topics]
    sent = [f"*/{resolve_name(name)[1:]}/*/*" for name in access.commands]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            _rule("to be there", _DECLARED, _EVERYTHING),
            _rule("to ask", ["query"], [*used, *(f"{key}/@adv/**" for key in read)]),
            _rule("to hear", ["put", "delete"], read, "egress"),
            *([_rule("to say", ["put", "delete"], sent, "ingress")] if sent else []),
        ],
        "subjects": [{"id": "everybody"}],
        "policies": [
            {
                "rules": ["to be there", "to ask", "to hear", *(["to say"] if sent else [])],
                "subjects": ["everybody"],
            }
        ],
    }


def _rule(name: str, messages: list[str], keys: list[str], *flows: str) -> dict[str, object]:
    return {
        "id": name,
        "permission": "allow",
        "flows": list(flows or ("ingress", "egress")),
        "messages": messages,
        "key_exprs": keys,
    }
