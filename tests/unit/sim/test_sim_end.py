"""A server that is stopped ends, whatever it was sending."""

import asyncio

from orbitfb.sim.access.context import end_tasks


def test_a_task_that_forgets_that_it_was_cancelled_is_cancelled_again():
    """As one does that waits by `asyncio.wait_for` for what has just come, in Python 3.11."""
    forgotten = 0

    async def busy() -> None:
        nonlocal forgotten
        while True:
            try:
                await asyncio.sleep(60.0)
            except asyncio.CancelledError:
                forgotten += 1
                if forgotten == 3:
                    raise

    async def stop() -> None:
        tasks = [asyncio.create_task(busy()), asyncio.create_task(asyncio.sleep(60.0))]
        await asyncio.sleep(0.0)
        await asyncio.wait_for(end_tasks(tasks), 10.0)
        assert all(task.cancelled() for task in tasks)

    asyncio.run(stop())
    assert forgotten == 3


def test_it_ends_them_although_it_is_cancelled_meanwhile():
    async def late() -> None:
        try:
            await asyncio.sleep(60.0)
        except asyncio.CancelledError:
            await asyncio.sleep(0.01)

    async def stop() -> None:
        task = asyncio.create_task(late())
        await asyncio.sleep(0.0)
        ending = asyncio.create_task(end_tasks([task]))
        await asyncio.sleep(0.0)
        ending.cancel()
        await ending
        assert task.done()

    asyncio.run(stop())
