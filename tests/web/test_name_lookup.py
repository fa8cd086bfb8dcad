"""Names and types, in all spellings that clients use."""

from __future__ import annotations

import pytest

from turtleact.errors import UnknownInterface
from turtleact.interfaces import get_interface
from turtleact.web.name_lookup import (
    message_class,
    service_class,
)


@pytest.mark.parametrize(
    "spelled",
    ["turtlesim/Pose", "turtlesim/msg/Pose", "turtlesim::msg::dds_::Pose_", "turtlesim::Pose"],
)
def test_a_message_is_known_by_every_spelling_of_its_type(spelled):
    assert message_class(spelled) is get_interface("turtlesim/msg/Pose")


def test_a_type_that_an_action_implies_is_known():
    name = "example_interfaces/action/Fibonacci_SendGoal"
    assert service_class(name) is get_interface(name)


def test_a_type_of_another_kind_is_unknown():
    with pytest.raises(UnknownInterface, match="std_srvs/srv/SetBool"):
        message_class("std_srvs/srv/SetBool")


@pytest.mark.parametrize("spelled", ["", "/", "nope", "a/Nope", "../../etc/passwd", "a::", "é/É"])
def test_a_type_that_does_not_exist_is_unknown(spelled):
    with pytest.raises(UnknownInterface):
        message_class(spelled)
