"""What the interface itself refuses, whatever the transport."""

from __future__ import annotations

import pytest

from turtleact.errors import InvalidMessage
from turtleact.transports import QoS


@pytest.mark.parametrize("depth", [0, -1, 2.5, "10", None])
def test_a_depth_is_a_whole_number_from_one(depth):
    with pytest.raises(InvalidMessage, match=r"qos\.depth: expected a whole number from 1, not"):
        QoS(depth=depth)


def test_a_policy_is_one_of_those_there_are():
    with pytest.raises(InvalidMessage) as caught:
        QoS(durability="latched")  # type: ignore[arg-type]  # so it is refused at run time too
    assert str(caught.value) == (
        "qos.durability: expected volatile or transient_local, not 'latched'"
    )
    with pytest.raises(InvalidMessage, match=r"qos\.reliability: expected reliable or best_effort"):
        QoS(reliability="sure")  # type: ignore[arg-type]  # likewise
