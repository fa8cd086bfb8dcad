"""The roster: names and indices, and what a new turtle is called."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from turtleact.errors import SimError
from turtleact.sim.world import Names

names = st.lists(st.sampled_from(["a", "turtle1", "turtle10", "turtle2", "z"]), max_size=12)


@given(names)
def test_names_are_in_order_and_known_by_their_indices_whoever_comes_and_goes(comings):
    roster, there = Names(["turtle2", "b"]), {"turtle2", "b"}
    for name in comings:
        if name in there:
            roster.remove(roster.index(name))
        else:
            assert roster.add(name) == roster.index(name)
        there ^= {name}
        assert list(roster.names) == sorted(there)
        assert [roster.index(name) for name in roster.names] == [*range(len(there))]


def test_new_names_are_counted_on_past_those_in_use():
    roster = Names(["turtle1", "turtle2"])
    roster.add("turtle4")
    assert [roster.free_name() for _ in range(3)] == ["turtle3", "turtle5", "turtle6"]


def test_a_name_of_its_own_is_taken_as_it_is():
    assert Names(["turtle1"]).free_name("bob") == "bob"


def test_a_name_that_is_in_use_is_refused():
    with pytest.raises(SimError, match=r"^turtle1: a turtle has this name already: give another$"):
        Names(["turtle1"]).free_name("turtle1")


@pytest.mark.parametrize("turtle", ["bob", "", -1, 4])
def test_an_unknown_turtle_is_refused_with_some_of_those_there_are(turtle):
    with pytest.raises(SimError, match=r"give a name \(a, b, c, …\) or an index to 3$"):
        Names("abcd").index(turtle)


def test_an_empty_roster_says_so():
    with pytest.raises(
        SimError, match=r"^there is no turtle 'a', because the world is empty: spawn one$"
    ):
        Names([]).index("a")
