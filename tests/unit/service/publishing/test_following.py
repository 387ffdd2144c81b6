"""What is told outside of the machine's stops, from the real latch and database."""

import asyncio
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

from service.machine.execution.stops import LatchedStops
from service.publishing.following import Following
from service.publishing.state import Notice, PublishedState
from service.store.database import open_database
from service.store.lease_and_latch import StopLatch
from service.store.store import Store


async def test_a_stop_is_told_once_before_and_after_the_database_knows_it(tmp_path: Path) -> None:
    told: list[Any] = []
    asked = asyncio.Queue[None]()

    class ThePublisher:
        def notice(self, notice: Notice) -> None:
            told.append(cast("Any", notice.data)["latched"])

        def state(self, state: PublishedState) -> None:
            pass

    with open_database(f"sqlite:///{tmp_path / 'sweepid.sqlite'}") as database:
        holds = LatchedStops(StopLatch(database), ())

        class TheMachine:
            answers, forbidden, silence = True, "", ""
            statement = SimpleNamespace(state=SimpleNamespace(value="stands"))
            stops = property(lambda self: holds.documents)

            async def ask(self) -> None:
                asked.put_nowait(None)

        machine, runner = cast("Any", TheMachine()), cast("Any", None)
        following = Following(Store(database), machine, runner, "cell 7", cast("Any", ThePublisher()))
        looking = asyncio.create_task(following.look())

        async def looked() -> None:
            for _ in range(asked.qsize() + 2):
                await asked.get()

        hold = holds.latch("Ada", "a test", "press 1")
        await looked()
        before = hold.document.id
        holds.note()
        await holds.noted()
        assert before < 0 < hold.document.id
        await looked()
        assert told == [True]
        hold.under_way = 0
        await holds.reset("Ada", [hold.document.id])
        await looked()
        assert told == [True, False]
        looking.cancel()
