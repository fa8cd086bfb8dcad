"""How a session is configured, and why it cannot be opened. Pure.

A ``peer`` finds the others through the router that it connects to, and then talks with them
directly, as a node of ROS 2 does. A ``client`` talks through its router only. The ``router`` is
what the nodes of a machine look for.

Source: ``DEFAULT_RMW_ZENOH_SESSION_CONFIG.json5`` of rmw_zenoh; Zenoh's ``DEFAULT_CONFIG.json5``.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias, get_args

import msgspec

from turtleact.errors import InvalidOption

__all__ = [
    "PATIENCE",
    "Mode",
    "SessionConfig",
    "domain_of",
    "session_config",
    "why_not_open",
    "words",
]

Mode: TypeAlias = Literal["peer", "client", "router"]

#: So long a call waits for its answer (s), as in rmw_zenoh. Zenoh keeps a timer for each until
#: then, answered or not, so that no end at all would fill the memory.
PATIENCE = 600.0

#: The last domain whose ports ROS 2 can count with.
LAST_DOMAIN = 232

#: The environment variable that names the domain of a ROS 2 process.
DOMAIN_VARIABLE = "ROS_DOMAIN_ID"

#: Where a router listens, and where nodes look for one.
ROUTER = "tcp/localhost:7447"

CONNECT: dict[str, tuple[str, ...]] = {"peer": (ROUTER,), "client": (ROUTER,), "router": ()}
LISTEN: dict[str, tuple[str, ...]] = {
    "peer": ("tcp/localhost:0",),
    "client": (),
    "router": ("tcp/127.0.0.1:7447",),
}

#: What a session has where nothing else is said: path to value.
DEFAULTS: dict[str, object] = {
    "scouting/delay": 0,  # or opening takes half a second
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "timestamping/enabled": True,  # latched topics need it
    "connect/timeout_ms": 0,  # an endpoint that refuses is not tried again while opening
    "connect/exit_on_failure": True,
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
}

#: The same, for what Zenoh has other defaults for.
TIGHTER: dict[str, object] = {
    # How long to wait for a peer's greeting (ms). On a line that loses each tenth packet, every
    # second greeting takes more than two seconds.
    "transport/unicast/open_timeout": 5000,
    # After this time (us) a peer that stops reading is disconnected. Until then it delays others.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1_000_000,
}


SOURCE_LINE = re.compile(r" at /\S+:[0-9]+\.?")

#: In brackets stands what happened, behind the address; before them what was tried, with it, too.
INNER = re.compile(r".*\[(?:\S+: )?(.*)\]")


class SessionConfig(msgspec.Struct, frozen=True):
    """What a session is opened with.

    Attributes:
        domain: The ROS domain.
        text: A whole configuration in JSON5 to begin with; empty for Zenoh's own.
        settings: Path to value as JSON: what is set in any case.
        defaults: Path to value as JSON: what is set where the text says nothing.
        connect: Where it connects to, as far as it is known here.
        listen: Where it listens, likewise.
    """

    domain: int
    text: str
    settings: dict[str, str]
    defaults: dict[str, str]
    connect: tuple[str, ...]
    listen: tuple[str, ...]


def domain_of(environment: Mapping[str, str]) -> int:
    """The ROS domain that the environment names by ``ROS_DOMAIN_ID``, 0 if it names none.

    >>> domain_of({"ROS_DOMAIN_ID": "7"}), domain_of({"ROS_DOMAIN_ID": ""}), domain_of({})
    (7, 0, 0)

    Raises:
        InvalidOption: if the variable is no domain.
    """
    text = environment.get(DOMAIN_VARIABLE) or "0"
    is_number = text.isascii() and text.isdigit() and len(text) <= 3
    if not is_number or int(text) > LAST_DOMAIN:
        raise InvalidOption(DOMAIN_VARIABLE, f"expected 0 to {LAST_DOMAIN}, not {text!r}")
    return int(text)


def session_config(
    connect: Sequence[str] | None,
    listen: Sequence[str] | None,
    mode: Mode,
    domain: int,
    config: Mapping[str, object] | str,
) -> SessionConfig:
    """The configuration of a session; the options are those of `open_zenoh`.

    Raises:
        InvalidOption: if one of them has a value that it cannot have.
    """
    if mode not in get_args(Mode):
        raise InvalidOption("mode", f"expected 'peer', 'client' or 'router', not {mode!r}")
    if type(domain) is not int or not 0 <= domain <= LAST_DOMAIN:
        raise InvalidOption("domain", f"expected 0 to {LAST_DOMAIN}, not {domain!r}")
    text = config if isinstance(config, str) else ""
    more = {} if isinstance(config, str) else config
    to = _endpoints("connect", connect, () if text else CONNECT[mode])
    at = _endpoints("listen", listen, () if text else LISTEN[mode])
    defaults: dict[str, object] = {"mode": mode, **DEFAULTS, **TIGHTER}
    settings: dict[str, object] = {}
    if connect is not None or not text:
        settings["connect/endpoints"] = to
    if listen is not None or not text:
        settings["listen/endpoints"] = at
    if not text:
        defaults, settings = {}, {**defaults, **settings, **more}
    return SessionConfig(domain, text, _as_json(settings), _as_json(defaults), to, at)


def _endpoints(
    option: str, given: Sequence[str] | None, default: tuple[str, ...]
) -> tuple[str, ...]:
    if given is None:
        return default
    if isinstance(given, str) or not all(isinstance(each, str) and "/" in each for each in given):
        example = f"['{ROUTER}']"
        raise InvalidOption(option, f"expected a list of endpoints such as {example}, not {given}")
    return tuple(given)


def _as_json(values: Mapping[str, object]) -> dict[str, str]:
    try:
        return {path: json.dumps(value) for path, value in values.items()}
    except (TypeError, ValueError) as error:
        raise InvalidOption("config", f"expected values that JSON can say: {error}") from error


def words(text: str) -> str:
    """What Zenoh says, without the lines of its source that it names, in brackets or behind.

    >>> words("Unicast not supported for foo protocol at /zenoh-link/src/lib.rs:183.")
    'Unicast not supported for foo protocol'
    """
    return SOURCE_LINE.sub("", text).rstrip(".!")


def why_not_open(config: SessionConfig, said: str) -> str:
    """Why a session cannot be opened: where that was, and what to do.

    Args:
        config: What it was to be opened with.
        said: The `words` of Zenoh.
    """
    if "listener" in said or (config.listen and not config.connect):
        at = ", ".join(config.listen) or "the configured endpoints"
        hint = "; is another router there already? connect to it" if "in use" in said else ""
        inner = INNER.fullmatch(said)
        return f"cannot listen at {at}: {inner[1] if inner else said}{hint}"
    to = ", ".join(config.connect) or "the configured endpoints"
    says_nothing_more = said.startswith("Unable to connect") or "Connection refused" in said
    more = "" if says_nothing_more else f" ({said})"
    return f"no ROS 2 graph in reach: nobody at {to} lets us in{more}; is a router running there?"
