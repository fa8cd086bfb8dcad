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

__all__ = ["Depth", "Durability", "Reliability", "read_policies"]

P = TypeVar("P")

Reliability = Annotated[
    str | None,
    typer.Option(
        "--qos-reliability",
        metavar="POLICY",
        help="reliable or best_effort.",
        autocompletion=completing.words("reliable", "best_effort"),
    ),
]
Durability = Annotated[
    str | None,
    typer.Option(
        "--qos-durability",
        metavar="POLICY",
        help="volatile or transient_local.",
        autocompletion=completing.words("volatile", "transient_local"),
    ),
]
Depth = Annotated[
    str | None, typer.Option("--qos-depth", metavar="N", help="How many messages are kept.")
]

_RELIABILITIES: dict[str, policies.Reliability] = {
    "reliable": "reliable",
    "best_effort": "best_effort",
}
_DURABILITIES: dict[str, policies.Durability] = {
    "volatile": "volatile",
    "transient_local": "transient_local",
}


def read_policies(
    reliability: str | None, durability: str | None, depth: str | None
) -> policies.Policies:
    """The policies that are asked for.

    Raises:
        UsageError: if one of them is none.
    """
    return policies.Policies(
        _policy("--qos-reliability", reliability, _RELIABILITIES),
        _policy("--qos-durability", durability, _DURABILITIES),
        None if depth is None else whole("--qos-depth", depth, least=1),
    )


def _policy(option: str, text: str | None, words: Mapping[str, P]) -> P | None:
    if text is None:
        return None
    try:
        return words[text]
    except KeyError:
        raise UsageError(f"{option} is {' or '.join(words)}, not {quoted(text)}") from None
