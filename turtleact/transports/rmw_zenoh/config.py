"""Builds the configuration of a Zenoh session, and explains why a session cannot be opened.

A session in the mode ``peer`` finds other peers through a router and then exchanges messages with
them directly, like a ROS 2 node. A ``client`` communicates only through its router. A ``router``
accepts the connections of peers and clients.

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

#: How long a call waits for its answer (s), as in rmw_zenoh. Zenoh keeps a timer per call until
#: then, answered or not, so without an end the timers would fill the memory.
PATIENCE = 600.0

#: The highest domain for which ROS 2 can compute ports.
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

#: The settings of a session unless others are given: path to value.
DEFAULTS: dict[str, object] = {
    "scouting/delay": 0,  # otherwise opening takes half a second
    "scouting/multicast/enabled": False,
    "scouting/gossip/enabled": True,
    "timestamping/enabled": True,  # latched topics need it
    "connect/timeout_ms": 0,  # do not retry an endpoint that refuses while opening
    "connect/exit_on_failure": True,
    # Zenoh waits up to 4 s before it connects again to a router that has gone.
    "connect/retry": {"period_init_ms": 250, "period_max_ms": 1000, "period_increase_factor": 2},
    "listen/timeout_ms": 0,
    "listen/exit_on_failure": True,
    # How long to wait for a peer's greeting (ms). On a connection that loses one packet in ten,
    # every second greeting takes more than two seconds.
    "transport/unicast/open_timeout": 5000,
    # After this time (us), a peer that stops reading is disconnected. Until then it delays others.
    "transport/link/tx/queue/congestion_control/block/wait_before_close": 1_000_000,
}

#: The settings of a router: like that of rmw_zenoh, it tells who asks what it is and whom it knows.
ROUTER_DEFAULTS: dict[str, object] = {
    "adminspace": {"enabled": True, "permissions": {"read": True, "write": False}},
}

#: What to do if another program listens at the endpoint.
TAKEN = "if a router listens there, connect to it; if not, end that program or use another port"

SOURCE_LINE = re.compile(r" at /\S+:[0-9]+\.?")

#: Zenoh puts what happened in brackets, after an address. Before them it says what it tried.
INNER = re.compile(r".*\[(?:\S+: )?(.*)\]")


class SessionConfig(msgspec.Struct, frozen=True):
    """The configuration of a session.

    Attributes:
        text: A complete configuration in JSON5, to which ``settings`` and ``defaults`` are applied;
            empty to start from Zenoh's default configuration.
        settings: Settings that replace those of ``text``: a mapping from paths to values in JSON.
        defaults: Settings that apply only where the configuration of ``text`` has no value: a
            mapping from paths to values in JSON.
        connect: The endpoints to connect to. Only error messages use this attribute. Endpoints that
            are given only in ``text`` are left out.
        listen: The endpoints to listen on. Only error messages use this attribute. Endpoints that
            are given only in ``text`` are left out.
    """

    text: str
    settings: dict[str, str]
    defaults: dict[str, str]
    connect: tuple[str, ...]
    listen: tuple[str, ...]


def domain_of(environment: Mapping[str, str]) -> int:
    """Return the ROS domain in ``ROS_DOMAIN_ID``, or 0 if it is not set.

    >>> domain_of({"ROS_DOMAIN_ID": "7"}), domain_of({"ROS_DOMAIN_ID": ""}), domain_of({})
    (7, 0, 0)

    Raises:
        InvalidOption: if the value of the variable is not a number from 0 to 232.
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
    """Build the configuration of a session. The arguments are the options of `open_zenoh`.

    Raises:
        InvalidOption: if the value of an option is not allowed.
    """
    if mode not in get_args(Mode):
        raise InvalidOption("mode", f"expected 'peer', 'client' or 'router', not {mode!r}")
    if type(domain) is not int or not 0 <= domain <= LAST_DOMAIN:
        raise InvalidOption("domain", f"expected 0 to {LAST_DOMAIN}, not {domain!r}")
    text = config if isinstance(config, str) else ""
    more = {} if isinstance(config, str) else config
    to = _endpoints("connect", connect, () if text else CONNECT[mode])
    at = _endpoints("listen", listen, () if text else LISTEN[mode])
    defaults: dict[str, object] = {"mode": mode, **DEFAULTS}
    if mode == "router":
        defaults |= ROUTER_DEFAULTS
    settings: dict[str, object] = {}
    if connect is not None or not text:
        settings["connect/endpoints"] = to
    if listen is not None or not text:
        settings["listen/endpoints"] = at
    if not text:
        defaults, settings = {}, {**defaults, **settings, **more}
    return SessionConfig(text, _as_json(settings), _as_json(defaults), to, at)


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
        raise InvalidOption("config", f"expected values that fit in JSON: {error}") from error


def words(text: str) -> str:
    """Return Zenoh's error message without the source files and lines that the message names.

    >>> words("Unicast not supported for foo protocol at /zenoh-link/src/lib.rs:183.")
    'Unicast not supported for foo protocol'
    """
    return SOURCE_LINE.sub("", text).rstrip(".!")


def why_not_open(config: SessionConfig, said: str) -> str:
    """Explain why a session cannot be opened, at which endpoint, and what to do.

    Args:
        config: The session's configuration.
        said: Zenoh's error message, as `words` returns it.
    """
    if "listener" in said or (config.listen and not config.connect):
        at = ", ".join(config.listen) or "the configured endpoints"
        hint = f"; {TAKEN}" if "in use" in said else ""
        inner = INNER.fullmatch(said)
        return f"cannot listen at {at}: {inner[1] if inner else said}{hint}"
    to = ", ".join(config.connect) or "the configured endpoints"
    begins, starts = "no ROS 2 graph in reach:", "'turtleact serve' starts one"
    if said.startswith("Received a close message"):
        return f"{begins} the router at {to} rejects the connection ({said}); is a password needed?"
    if said.startswith("Unable to connect"):  # Zenoh does not say if there is a router
        return f"{begins} no router at {to} accepts the connection; {starts}"
    if "early eof" in said:  # it answered, but did not speak Zenoh
        no_router = f"the program that listens at {to} seems to be no router"
        return f"{begins} {no_router} ({said}): end it, or use another port"
    more = "" if "Connection refused" in said else f" ({said})"
    return f"{begins} no router answers at {to}{more}; {starts}"
