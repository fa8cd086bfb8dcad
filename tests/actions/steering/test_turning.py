"""What turning takes at least, beside what finely cut headings make of it."""

from __future__ import annotations

import cmath
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from turtleact.actions.steering.bounds import ROOM, Cell, Leg, Turning, View, least_loss

angles = st.floats(-math.pi, math.pi)
halves = st.sampled_from([math.pi, math.pi / 2])


def lost(angle):
    return angle - math.sin(min(angle, math.pi / 2))


def leg(angle, least, most=math.inf):
    return Leg(cmath.rect(1.0, angle), least, most)


def found(legs, *, half=math.pi, parts=4, last=None, slack=0.0, **options):
    turning = Turning(half=half, tick=0.0, parts=parts, last=last, slack=slack)
    return least_loss(1.0 + 0j, legs, turning, **options)


def loss(legs, **options):
    return found(legs, **options)[0]


def test_a_long_leg_straight_ahead_takes_no_turning():
    assert loss([leg(0.0, 5.0)]) == 0.0


@pytest.mark.parametrize("angle", [0.5, -0.5, 2.0, math.pi])
def test_a_long_leg_takes_the_whole_turn_to_it(angle):
    assert loss([leg(angle, 5.0)]) == pytest.approx(lost(abs(angle)))


def test_a_turtle_that_may_reverse_turns_to_the_nearer_end_of_a_leg():
    assert loss([leg(math.pi - 0.5, 5.0)], half=math.pi / 2) == pytest.approx(lost(0.5))


def test_a_corner_between_long_legs_is_turned_half_before_and_half_after():
    assert loss([leg(0.0, 5.0), leg(2.0, 5.0)]) == pytest.approx(2.0 * lost(1.0))


def test_a_short_leg_takes_only_the_turn_that_its_way_needs():
    turned = math.asin(1.0 - 0.5)  # from a right angle, half a radius is made down to here
    expected = lost(math.pi / 2) - lost(turned)
    assert loss([leg(math.pi / 2, 0.5)]) == pytest.approx(expected)


def test_a_leg_that_asks_for_no_way_takes_no_turn():
    assert loss([leg(math.pi, -0.1)]) == 0.0


def test_turning_on_the_same_way_on_a_short_leg_takes_longer_than_turning_back():
    begun = [leg(0.0, 5.0), leg(2.0, 0.1, 0.3)]
    assert loss([*begun, leg(4.0, 5.0)]) > loss([*begun, leg(0.0, 5.0)]) + 0.5


def test_a_heading_at_the_end_is_turned_to():
    assert loss([leg(0.0, 5.0)], last=2.0) == pytest.approx(lost(2.0))


def test_a_short_way_to_the_side_and_back_takes_more_than_its_own_direction_shows():
    forth, back = leg(0.0, 0.5, 0.5), leg(math.pi, 0.5, 0.5)
    aside = View(math.pi / 2, 0.0, 0.0, -0.5)
    seen = [replace(forth, views=(aside,)), replace(back, views=(aside,))]
    assert loss(seen) > loss([forth, back]) + 0.05


def test_a_leg_that_is_left_out_takes_what_it_turns():
    left_out = replace(leg(0.0, 0.5), is_left_out=True)
    expected = lost(math.pi / 2)  # the long leg's share; all of the turn would take more
    assert loss([left_out, leg(math.pi / 2, 5.0)]) == pytest.approx(expected, abs=0.1)
    assert loss([left_out], last=2.0) == pytest.approx(2.0)


def test_a_leg_that_is_left_out_never_gives_anything_back():
    left_out = replace(leg(0.0, 0.5), is_left_out=True)
    assert loss([left_out], last=0.1, slack=1.0) == 0.0


@given(angles, angles, halves)
def test_a_view_in_the_direction_of_its_leg_proves_nothing_new(first, second, half):
    legs = [leg(first, 0.5, 0.9), leg(second, 1.0, 1.4)]
    views = [View(cmath.phase(each.unit), each.least, each.most) for each in legs]
    seen = [replace(each, views=(view,)) for each, view in zip(legs, views, strict=True)]
    assert loss(seen, half=half) == pytest.approx(loss(legs, half=half))


@given(angles, angles, st.floats(-0.2, 3.0), halves)
def test_finer_cells_prove_more(first, second, least, half):
    legs = [leg(first, least, least + 0.4), leg(second, 1.0, 1.4), leg(0.0, 0.5, 0.9)]
    coarse, fine = (loss(legs, half=half, parts=parts) for parts in (1, 2))
    assert coarse <= fine + 1e-9


@given(angles, st.floats(ROOM, 4.0), st.floats(ROOM, 4.0))
def test_no_cell_proves_more_than_the_best_heading_there_is(angle, first, second):
    legs = [leg(0.0, first), leg(angle, ROOM - 1e-9, second)]  # too short to do without cells
    best = 2.0 * lost(abs(angle) / 2.0)
    assert loss(legs) <= best + 1e-9


def test_what_is_known_of_the_first_legs_is_used_again():
    known: dict[tuple[Leg, ...], list[Cell]] = {}
    legs = [leg(1.0, 1.0, 1.4), leg(2.0, 1.0, 1.4)]

    def least():
        return loss(legs, parts=1, known=known)

    before = least()
    assert list(known) == [tuple(legs)]
    known[tuple(legs)] = [replace(cell, cost=cell.cost + 1.0) for cell in known[tuple(legs)]]
    assert least() == pytest.approx(before + 1.0)


def test_the_headings_that_take_least_are_told():
    _, headings = found([leg(0.0, 5.0), leg(1.0, 5.0), leg(2.0, 5.0)])
    assert headings == pytest.approx([0.5, 1.5])


@given(angles, angles, angles, halves)
def test_headings_tried_first_change_no_answer(first, second, tried, half):
    legs = [leg(first, 0.5, 0.9), leg(second, 1.0, 1.4), leg(0.0, 0.5, 0.9)]
    least, headings = found(legs, half=half)
    for near in (headings, [tried, tried]):
        assert loss(legs, half=half, tried=near) == pytest.approx(least, abs=1e-9)


def test_headings_that_take_little_enough_are_the_answer():
    legs = [leg(0.0, 1.0, 1.4), leg(2.0, 1.0, 1.4)]
    astray = loss(legs, tried=[-1.0], enough=9.0)
    assert loss(legs) < astray < 9.0
    assert loss(legs, tried=[-1.0], enough=astray - 1e-9) == loss(legs)
