"""Who may come in."""

from __future__ import annotations

import pytest

from turtleact.web.access import TELL_EVERY, Access, RefusalCounter

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


@pytest.mark.parametrize("token", ["", "Secret", "secret ", "sécret"])
def test_a_wrong_token_is_refused(token):
    access = Access(token="secret")
    assert "the token is missing" in access.problem(host="localhost", origin=None, token=token)


def test_the_right_token_comes_in():
    assert Access(token="secret").problem(host="localhost", origin=None, token="secret") == ""


# what is logged


def test_the_first_refusal_is_logged_at_once_and_later_ones_as_a_count(caplog):
    refusals = RefusalCounter()
    for second in range(5):
        refusals.note("the token is wrong", float(second))
    refusals.note("rosbridge is at the path /", TELL_EVERY)
    assert caplog.messages == [
        "a web connection was refused: the token is wrong",
        "5 web connections were refused, the last one: rosbridge is at the path /",
    ]


def test_refusals_that_were_only_counted_are_told_at_the_end(caplog):
    refusals = RefusalCounter()
    for _ in range(2):
        refusals.note("the token is wrong", 0.0)
    refusals.tell()
    refusals.tell()
    assert caplog.messages == ["a web connection was refused: the token is wrong"] * 2
