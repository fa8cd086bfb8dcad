"""The socket, the token and the address of a web server; `web` and `mcp` test the rest."""

import socket

import anyio
import pytest

from turtleact.errors import InvalidOption
from turtleact.http_server import Access, Config, bound, is_loopback, serving, token_for


def test_small_frames_do_not_wait_for_one_another():
    with bound("127.0.0.1", 0) as listener, socket.create_connection(listener.getsockname()):
        accepted, _ = listener.accept()
        with accepted:
            assert accepted.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


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


# who may connect

OPEN = Access()
NAMED = Access(frozenset({"robot.example"}), frozenset({"https://console.example", "null"}))


@pytest.mark.parametrize(
    "host",
    ["localhost", "localhost:9090", "127.0.0.1:9090", "[::1]:9090", "10.1.2.3:80", "a.localhost"],
)
def test_loopback_names_and_addresses_come_in(host):
    assert OPEN.problem(host=host, origin=None, token="") == ""


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:9090",
        "localhost.evil.example",
        "",
        "[",
        "127.0.0.1.evil.example",
    ],
)
def test_a_name_that_could_be_rebound_is_refused(host):
    assert "host" in OPEN.problem(host=host, origin=None, token="")


def test_a_name_that_was_allowed_comes_in():
    assert NAMED.problem(host="Robot.example:80", origin=None, token="") == ""


@pytest.mark.parametrize(
    "origin",
    ["http://localhost:8000", "http://127.0.0.1:37857", "https://[::1]", "http://10.0.0.2:9090"],
)
def test_pages_of_loopback_hosts_and_of_the_server_itself_come_in(origin):
    assert OPEN.problem(host="10.0.0.2:9090", origin=origin, token="") == ""


@pytest.mark.parametrize(
    "origin",
    [
        "https://evil.example",
        "http://10.0.0.2:9091",
        "http://10.0.0.2",
        "null",
        "",
        "file://",
        "http://localhost.evil.example",
        "http://[",
    ],
)
def test_pages_of_others_are_refused(origin):
    assert "pages of" in OPEN.problem(host="10.0.0.2:9090", origin=origin, token="")


@pytest.mark.parametrize("origin", ["https://console.example", "null"])
def test_pages_that_were_allowed_come_in(origin):
    assert NAMED.problem(host="localhost", origin=origin, token="") == ""
