"""Uses MCP's elicitation to ask the user before a goal is sent or a service is called.

Up to version 2025-11-25 of the protocol, the server sends the question to the client as a request.
From version 2026-07-28 on, the server answers the call of a tool with the question and a token. The
client then repeats the call with the user's answer and the token. The token is valid only once, and
only for the same tool with the same arguments.

Source: MCP 2026-07-28, "Elicitation" and "Multi Round-Trip Requests".
"""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Final

from mcp.types import (
    ElicitRequest,
    ElicitRequestFormParams,
    ElicitResult,
    InputRequiredResult,
)

from turtleact.errors import TurtleactError

if TYPE_CHECKING:
    from mcp.types import CallToolRequestParams

    from turtleact.mcp.replies import Request

__all__ = ["Confirmation"]

QUESTION: Final = "confirm"
FIRST_VERSION: Final = "2026-07-28"
"""The first protocol version in which a reply to a tool call can ask for confirmation."""

MOST_ASKED: Final = 256
"""The maximum number of unanswered questions. A new question may replace the oldest one."""

FORM: Final = {"type": "object", "properties": {}}
"""The form that the user fills in. It has no fields; the user only answers yes or no."""


class Confirmation:
    """Asks users for confirmation, and remembers the questions that have no answer yet."""

    def __init__(self) -> None:
        self._asked: dict[str, tuple[str, object]] = {}

    async def ask(
        self, ctx: Request, params: CallToolRequestParams, question: str
    ) -> InputRequiredResult | None:
        """Ask the user, and return None if the user agrees.

        In protocol version 2026-07-28 and later, the first call returns a reply that contains the
        question. The client then repeats the tool's call with the user's answer.

        Raises:
            TurtleactError: if the user does not agree, or the client cannot ask its user.
        """
        capabilities = ctx.session.client_capabilities
        if capabilities is None or capabilities.elicitation is None:
            raise TurtleactError(
                "this needs the user's confirmation, but the client cannot ask its user: use a "
                "client with elicitation, or a server without --confirm"
            )
        if ctx.protocol_version < FIRST_VERSION:
            reply = await ctx.session.elicit_form(question, FORM, ctx.request_id)
        elif params.request_state is None:
            return self._begin(params, question)
        else:
            reply = self._take(params)
        if reply.action != "accept":
            raise TurtleactError(
                f"the user did not confirm this ({reply.action}): do not try again"
            )
        return None

    def _begin(self, params: CallToolRequestParams, question: str) -> InputRequiredResult:
        token = secrets.token_urlsafe(16)
        self._asked[token] = params.name, params.arguments
        for oldest in list(self._asked)[: max(0, len(self._asked) - MOST_ASKED)]:
            del self._asked[oldest]
        asked = ElicitRequest(
            params=ElicitRequestFormParams(message=question, requested_schema=FORM)
        )
        return InputRequiredResult(input_requests={QUESTION: asked}, request_state=token)

    def _take(self, params: CallToolRequestParams) -> ElicitResult:
        """Return the user's answer to the question about a call with this tool and arguments.

        Raises:
            TurtleactError: if the question was about another call, or has been answered before.
        """
        asked = self._asked.pop(params.request_state or "", None)
        reply = (params.input_responses or {}).get(QUESTION)
        if asked != (params.name, params.arguments) or not isinstance(reply, ElicitResult):
            raise TurtleactError(
                "the confirmation does not belong to this call, or was used before: call again"
            )
        return reply
