"""Quality of service, as Typer sees it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from turtleact.commands import policies
from turtleact.commands.verbs import completing
from turtleact.commands.verbs.arguments import quoted, whole
from turtleact.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["read_policies"]

P = TypeVar("P")

_RELIABILITIES: dict[str, policies.Reliability] = {
    "reliable": "reliable",
    "best_effort": "best_effort",
}
_DURABILITIES: dict[str, policies.Durability] = {
    "volatile": "volatile",
    "transient_local": "transient_local",
}
_PROFILES: dict[str, policies.Policies] = {
    "action_status_default": policies.Policies("reliable", "transient_local", 1),
    "best_available": policies.Policies(),
    "default": policies.Policies("reliable", "volatile", 10),
    "parameter_events": policies.Policies("reliable", "volatile", 1000),
    "parameters": policies.Policies("reliable", "volatile", 1000),
    "sensor_data": policies.Policies("best_effort", "volatile", 5),
    "services_default": policies.Policies("reliable", "volatile", 10),
    "system_default": policies.Policies(),
}
"""Source: rmw ``qos_profiles.h``."""

_Profile = Annotated[
    str | None,
    typer.Option(
        "--qos-profile",
        metavar="NAME",
        help="A set of policies, such as sensor_data; single ones are said besides.",
        autocompletion=completing.words(*_PROFILES),
    ),
]
_Reliability = Annotated[
    str | None,
    typer.Option(
        "--qos-reliability",
        metavar="POLICY",
        help="reliable or best_effort.",
        autocompletion=completing.words(*_RELIABILITIES),
    ),
]
_Durability = Annotated[
    str | None,
    typer.Option(
        "--qos-durability",
        metavar="POLICY",
        help="volatile or transient_local.",
        autocompletion=completing.words(*_DURABILITIES),
    ),
]
_Depth = Annotated[
    str | None, typer.Option("--qos-depth", metavar="N", help="How many messages are kept.")
]


def read_policies(
    profile: _Profile = None,
    reliability: _Reliability = None,
    durability: _Durability = None,
    depth: _Depth = None,
) -> policies.Policies:
    """The policies that are asked for; a single one counts more than the profile.

    Raises:
        UsageError: if one of them is none.
    """
    known = _policy("--qos-profile", profile, _PROFILES) or policies.Policies()
    return policies.Policies(
        _policy("--qos-reliability", reliability, _RELIABILITIES) or known.reliability,
        _policy("--qos-durability", durability, _DURABILITIES) or known.durability,
        known.depth if depth is None else whole("--qos-depth", depth, least=1),
    )


def _policy(option: str, text: str | None, words: Mapping[str, P]) -> P | None:
    if text is None:
        return None
    try:
        return words[text]
    except KeyError:
        raise UsageError(f"{option} is {' or '.join(words)}, not {quoted(text)}") from None
