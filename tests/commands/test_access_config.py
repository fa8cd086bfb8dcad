"""The file that says who may come in."""

from __future__ import annotations

from pathlib import Path

import pytest

import turtleact
from turtleact.commands.access_config import (
    Access,
    AccessConfig,
    Login,
    Tls,
    mode_of,
    read_access_config,
)
from turtleact.errors import TurtleactError, UsageError
from turtleact.transports import open_zenoh

from ..lab import Count, count, free_endpoint, goal, result


@pytest.fixture
def address() -> str:
    return free_endpoint()


# --- the file -----------------------------------------------------------------------------------


def test_a_file_says_all_there_is(tmp_path: Path):
    for name in ("ca.pem", "robot.pem", "robot.key", "users.txt"):
        (tmp_path / name).write_text("")
    file = tmp_path / "serve.toml"
    file.write_text(
        """
        [tls]
        ca = "ca.pem"
        certificate = "robot.pem"
        key = "robot.key"
        mutual = true
        [login]
        user = "robot"
        password = "secret"
        users = "users.txt"
        [access]
        actions = ["patrol"]
        """
    )
    found = read_access_config(str(file)).settings()
    access = found.pop("access_control")
    assert isinstance(access, dict)
    assert found == {
        "transport/link/tls/root_ca_certificate": str(tmp_path / "ca.pem"),
        "transport/link/tls/listen_certificate": str(tmp_path / "robot.pem"),
        "transport/link/tls/listen_private_key": str(tmp_path / "robot.key"),
        "transport/link/tls/connect_certificate": str(tmp_path / "robot.pem"),
        "transport/link/tls/connect_private_key": str(tmp_path / "robot.key"),
        "transport/link/tls/enable_mtls": True,
        "transport/auth/usrpwd/user": "robot",
        "transport/auth/usrpwd/password": "secret",
        "transport/auth/usrpwd/dictionary_file": str(tmp_path / "users.txt"),
    }
    assert (access["enabled"], access["default_permission"]) == (True, "deny")


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[tls", "Expected ']'"),
        ("[lts]", "unknown field `lts`"),
        ("[tls]\nmutual = 1", "Expected `bool`, got `int` - at `$.tls.mutual`"),
        ('[tls]\nca = "nowhere.pem"', "tls.ca: there is no file"),
        ('[login]\nusers = "nowhere.txt"', "login.users: there is no file"),
        ('[login]\nuser = "a"', "login: give both user and password, or neither"),
    ],
)
def test_a_file_that_is_wrong_is_refused(tmp_path: Path, text, problem):
    file = tmp_path / "serve.toml"
    file.write_text(text)
    with pytest.raises(UsageError) as caught:
        read_access_config(str(file))
    assert str(caught.value).startswith(f"--config {file}: ")
    assert problem in str(caught.value)


@pytest.mark.parametrize(
    ("access", "keeps_out"),
    [
        (AccessConfig(), False),
        (AccessConfig(tls=Tls(mutual=True)), True),
        (AccessConfig(login=Login(users="users.txt")), True),
        (AccessConfig(access=Access(actions=("patrol",))), True),
    ],
)
def test_who_is_kept_out(access, keeps_out):
    assert access.keeps_strangers_out is keeps_out


@pytest.mark.parametrize(
    ("connect", "access", "mode"),
    [
        (("tcp/localhost:7447",), AccessConfig(), "peer"),
        (("tcp/localhost:7447", "tcp/robot:7447"), AccessConfig(), "client"),
        ((), AccessConfig(tls=Tls(ca="ca.pem"), access=Access()), "peer"),
        ((), AccessConfig(login=Login("robot", "secret")), "client"),
    ],
)
def test_a_command_is_a_peer_unless_peers_would_not_reach_each_other(connect, access, mode):
    assert mode_of(connect, access) == mode


# --- what becomes of it -------------------------------------------------------------------------


async def test_only_who_knows_the_password_comes_in(tmp_path: Path, address):
    users = tmp_path / "users.txt"
    users.write_text("robot:secret\n")
    robot = AccessConfig(login=Login("robot", "secret", str(users))).settings()
    right = AccessConfig(login=Login("robot", "secret")).settings()
    wrong = AccessConfig(login=Login("robot", "guessed")).settings()
    async with open_zenoh(mode="router", listen=[address], config=robot):
        async with open_zenoh([address], mode="client", config=right):
            pass
        for config in (wrong, {}):
            with pytest.raises(TurtleactError, match=r"no router at .* accepts the connection"):
                async with open_zenoh([address], mode="client", config=config):
                    pass


async def test_only_what_is_named_can_be_used(address):
    access = AccessConfig(access=Access(actions=("open",), topics=("/status",)))
    async with (
        open_zenoh(mode="router", listen=[address], config=access.settings()) as far,
        open_zenoh([address], mode="client", config={}) as near,
        turtleact.open_node("robot", transport=far) as robot,
        turtleact.open_node("guest", transport=near) as guest,
    ):
        robot.action_server(Count, "open", count)
        robot.action_server(Count, "closed", count)
        client = guest.action_client(Count, "open")
        assert await client.wait_for_server(5)
        async with client.send_goal(goal()) as handle:
            assert len([each async for each in handle]) == 3
            assert await handle.result() == result(0, 1, 2)
        assert (await client.cancel_all()).return_code == 0
        other = guest.action_client(Count, "closed")
        with pytest.raises(TurtleactError):
            await other.send_goal(goal())
