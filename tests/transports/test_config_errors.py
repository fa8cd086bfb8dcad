"""The texts are those of eclipse-zenoh 1.10, with shorter paths."""

from __future__ import annotations

import pytest

from turtleact.transports.rmw_zenoh.config import (
    SessionConfig,
    session_config,
    why_not_open,
    words,
)

AT = "tcp/127.0.0.1:7447"
TAKEN = (
    f"Can not create a new TCP listener bound to {AT}: [127.0.0.1:7447: Address already in use "
    "(os error 98) at /io/src/tcp.rs:61.] at /io/src/unicast.rs:338."
)
REFUSED = (
    f"Can not create a new TCP link bound to {AT}: [127.0.0.1:7447: Connection refused (os error "
    "111) at /io/src/tcp.rs:105.] at /io/src/tcp.rs:133. at /io/src/unicast.rs:287."
)
NO_KEY = (
    "Cannot create a new TLS listener on 127.0.0.1:0. Missing TLS private key. at /io/src/utils.rs"
    ":532. at /io/src/unicast.rs:426."
)


def config(connect: list[str], listen: list[str]) -> SessionConfig:
    return session_config(connect, listen, "peer", 0, "")


@pytest.mark.parametrize("text", [TAKEN, REFUSED, NO_KEY])
def test_the_lines_of_zenohs_source_are_left_out(text):
    assert ".rs" in text
    assert ".rs" not in words(text)


def test_what_keeps_it_from_listening_is_told_though_it_connects_too():
    at = "tls/127.0.0.1:0"
    assert why_not_open(config([AT], [at]), words(NO_KEY)) == (
        f"cannot listen at {at}: Cannot create a new TLS listener on 127.0.0.1:0. "
        "Missing TLS private key"
    )


def test_what_keeps_it_from_connecting_is_told():
    said = words(REFUSED).replace("Connection refused", "No route to host")
    assert why_not_open(config([AT], []), said) == (
        f"no ROS 2 graph in reach: no router answers at {AT} (Can not create a new TCP link bound "
        f"to {AT}: [127.0.0.1:7447: No route to host (os error 111)]); 'turtleact serve' starts one"
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (REFUSED, f"no router answers at {AT}"),
        ("Unable to connect to any of [peers]", f"no router at {AT} accepts the connection"),
    ],
)
def test_a_missing_router_is_reported_once_with_its_remedy(text, problem):
    said = why_not_open(config([AT], []), words(text))
    assert said == f"no ROS 2 graph in reach: {problem}; 'turtleact serve' starts one"


def test_a_program_that_is_no_router_is_not_called_a_missing_router():
    said = f"Read error on TCP link 127.0.0.1:46900 => {AT}: early eof"
    assert why_not_open(config([AT], []), said) == (
        f"no ROS 2 graph in reach: the program that listens at {AT} seems to be no router "
        f"({said}): end it, or use another port"
    )


def test_a_router_that_rejects_the_connection_is_no_missing_router():
    text = "Received a close message (reason 0) in response to an InitSyn"
    assert why_not_open(config([AT], []), text) == (
        f"no ROS 2 graph in reach: the router at {AT} rejects the connection ({text}); "
        "is a password needed?"
    )


def test_a_file_may_say_where_it_connects_or_listens():
    at_file = session_config(None, None, "peer", 0, "{}")
    assert why_not_open(at_file, words(TAKEN)).startswith("cannot listen at the configured endpoi")
    assert "no router answers at the configured endpoints" in why_not_open(at_file, words(REFUSED))
