"""How a session is configured."""

from __future__ import annotations

import json
from typing import Any

import pytest

from turtleact.errors import InvalidOption
from turtleact.transports.rmw_zenoh.config import session_config

MULTICAST = "scouting/multicast/enabled"


def settings(connect=None, listen=None, mode="peer", domain=0, config="") -> dict[str, Any]:
    made = session_config(connect, listen, mode, domain, config)
    return {path: json.loads(value) for path, value in {**made.defaults, **made.settings}.items()}


@pytest.mark.parametrize(
    ("mode", "connect", "listen"),
    [
        ("peer", ["tcp/localhost:7447"], ["tcp/localhost:0"]),
        ("client", ["tcp/localhost:7447"], []),
        ("router", [], ["tcp/127.0.0.1:7447"]),
    ],
)
def test_a_session_meets_the_nodes_of_this_machine_unless_it_is_told_where(mode, connect, listen):
    made = settings(mode=mode)
    assert (made["connect/endpoints"], made["listen/endpoints"]) == (connect, listen)
    assert made["mode"] == mode


def test_what_is_said_takes_the_place_of_the_default():
    made = settings(["tcp/robot:7447"], [], "client")
    assert (made["connect/endpoints"], made["listen/endpoints"]) == (["tcp/robot:7447"], [])


def test_opening_does_not_wait_to_find_others_and_nobody_is_waited_for_long():
    made = settings()
    assert (made["scouting/delay"], made["connect/timeout_ms"]) == (0, 0)
    assert made["transport/unicast/open_timeout"] == 5000
    assert made["timestamping/enabled"]


def test_a_mapping_has_the_last_word():
    made = settings(config={MULTICAST: True, "connect/endpoints": ["udp/a:1"]})
    assert (made[MULTICAST], made["connect/endpoints"]) == (True, ["udp/a:1"])


def test_a_file_keeps_what_it_says_but_for_what_is_said_here():
    made = session_config(None, ["tcp/a:1"], "client", 3, "{mode: 'router'}")
    assert made.text == "{mode: 'router'}"
    assert made.settings == {"listen/endpoints": '["tcp/a:1"]'}
    assert made.defaults["mode"] == '"client"'
    assert (made.connect, made.listen) == ((), ("tcp/a:1",))


def test_a_file_and_where_to_connect():
    made = session_config(["tcp/a:1"], None, "peer", 0, "{}")
    assert made.settings == {"connect/endpoints": '["tcp/a:1"]'}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            {"mode": "boat"},
            "option 'mode': expected 'peer', 'client' or 'router', not 'boat'",
        ),
        ({"domain": -1}, "option 'domain': expected 0 to 232, not -1"),
        ({"domain": 233}, "option 'domain': expected 0 to 232, not 233"),
        ({"domain": True}, "option 'domain': expected 0 to 232, not True"),
        (
            {"connect": "tcp/a:1"},
            "option 'connect': expected a list of endpoints such as ['tcp/localhost:7447'], "
            "not tcp/a:1",
        ),
        (
            {"listen": ["a:1"]},
            "option 'listen': expected a list of endpoints such as ['tcp/localhost:7447'], "
            "not ['a:1']",
        ),
        (
            {"config": {"mode": object}},
            "option 'config': expected values that fit in JSON: "
            "Object of type type is not JSON serializable",
        ),
    ],
)
def test_what_cannot_be_is_refused(options, said):
    with pytest.raises(InvalidOption) as caught:
        settings(**options)
    assert str(caught.value) == said
