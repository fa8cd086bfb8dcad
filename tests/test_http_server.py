"""The socket, the token and the address of a web server; `web` and `mcp` test the rest."""

import socket

import anyio
import pytest

from turtleact.errors import InvalidOption
from turtleact.http_server import Config, bound, is_loopback, serving, token_for

READ_AHEAD = 2**14


def test_small_frames_do_not_wait_for_one_another():
    with bound("127.0.0.1", 0) as listener, socket.create_connection(listener.getsockname()):
        accepted, _ = listener.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_a_client_that_says_much_is_not_read_far_ahead():
    with (
        bound("127.0.0.1", 0, read_ahead=READ_AHEAD) as listener,
        socket.create_connection(listener.getsockname()),
    ):
        accepted, _ = listener.accept()
        with accepted:
            assert accepted.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) <= 2 * READ_AHEAD


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.5", "::", "robot", ""])
def test_what_others_reach_is_no_loopback(host):
    assert not is_loopback(host)


@pytest.mark.parametrize(("host", "given"), [("localhost", ""), ("0.0.0.0", "own"), ("::1", "own")])
def test_a_token_that_was_chosen_is_used(host, given):
    assert token_for(host, given) == given


def test_a_token_is_made_only_if_other_machines_can_connect():
    assert token_for("127.0.0.1", None) == ""
    assert len(token_for("0.0.0.0", None)) > 16
    assert token_for("0.0.0.0", None) != token_for("0.0.0.0", None)


def test_other_machines_must_send_a_token():
    with pytest.raises(InvalidOption, match="must not be empty if other machines can connect"):
        token_for("192.168.1.5", "")


@pytest.mark.loops("asyncio")
async def test_a_server_ends_with_its_block_even_if_closing_fails():
    async def fail() -> None:
        raise ValueError("it cannot be closed")

    async def serve(_scope: object, _receive: object, _send: object) -> None:
        """Serves nothing."""

    with bound("127.0.0.1", 0) as listener:
        address = listener.getsockname()
        with pytest.raises(ValueError, match="cannot be closed"):
            async with serving(Config(serve), listener, fail):
                pass
    with pytest.raises(OSError, match="connect"):
        await anyio.connect_tcp(*address)
