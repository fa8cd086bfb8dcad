"""Clients that are opened once for all who use them."""

from __future__ import annotations

from turtleact.web.shared import MOST_IDLE, Pool


class Thing:
    def __init__(self, key: int) -> None:
        self.key = key
        self.is_open = True

    async def aclose(self) -> None:
        self.is_open = False


async def test_a_thing_is_opened_once():
    pool = Pool(Thing)
    async with pool.use(1) as one, pool.use(1) as same:
        assert one is same
    async with pool.use(1) as later:
        assert later is one


async def test_the_one_that_nobody_has_used_for_longest_is_closed():
    pool = Pool(Thing)
    things = []
    for key in [*range(MOST_IDLE), 0, MOST_IDLE]:
        async with pool.use(key) as thing:
            things.append(thing)
    assert [thing.key for thing in things if not thing.is_open] == [1]


async def test_what_is_used_stays_open():
    pool = Pool(Thing)
    async with pool.use(-1) as used:
        for key in range(2 * MOST_IDLE):
            async with pool.use(key):
                pass
        assert used.is_open


async def test_a_pool_closes_what_it_holds():
    pool = Pool(Thing)
    async with pool.use(1) as thing:
        pass
    await pool.aclose()
    assert not thing.is_open
