"""Many interleavings from one snapshot: what was set up once is copied (fork) for each seed.

At the moment of `Explorer.run` the whole simulated world (threads, clock, plant, service) is the snapshot. Each copy
gets a seed, does `step` and tells how it went; the original does not go on meanwhile. A seed that failed under
`make explore` is stored in `seeds/<test>.json` and runs first from then on, for ever.
"""

import asyncio
import faulthandler
import inspect
import json
import pickle
import signal
import time
import traceback
from collections.abc import Awaitable, Callable, Coroutine, Iterable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path

from tests.forked import fork, heard, tell
from tests.virtual_time import primitives, world

SEEDS = Path(__file__).parent / "seeds"
LONGEST = 60.0  # s of processor time that one interleaving may take


@dataclass(frozen=True)
class Outcome:
    """How one interleaving went. `error`: "" or the traceback; `cpu` in s of processor time, `virtual` in s."""

    seed: int
    error: str
    digest: str
    cpu: float
    virtual: float
    told: object = None


@dataclass
class Exploration:
    """All outcomes, stored seeds first."""

    outcomes: list[Outcome] = field(default_factory=list[Outcome])

    @property
    def failed(self) -> list[Outcome]:
        return [outcome for outcome in self.outcomes if outcome.error]

    @property
    def cpu(self) -> float:
        return sum(outcome.cpu for outcome in self.outcomes)

    def check(self, again: str) -> None:
        """AssertionError with the first failure and all failing seeds; `again`: how to repeat one."""
        if not self.failed:
            return
        seeds = " ".join(str(outcome.seed) for outcome in self.failed)
        first = self.failed[0]
        raise AssertionError(
            f"{len(self.failed)} of {len(self.outcomes)} interleavings failed, seeds {seeds}\n"
            f"again: {again} --seed {first.seed}\n{first.error}"
        )


Step = Callable[[int], object | Awaitable[object]]


class Explorer:
    """The fixture `explore`: `await explore.run(step, 9)`; without an event loop `at_once(explore.run(step, 9))`."""

    def __init__(self, test: str, only: int, factor: float, log: str = "") -> None:
        """`test`: its node id. `only`: one seed, 0: all. `factor`: how many times as many seeds as the test asks for;
        with more than 1, failures are stored. `log`: file that gets each outcome, "" for none.
        """
        self._test, self._only, self._factor, self._log = test, only, factor, log
        name = test.rpartition("/")[2].replace(".py::", ".").replace("/", "-")
        self._stored = SEEDS / f"{name}.json"

    @property
    def stored(self) -> list[int]:
        """Seeds that failed once."""
        return json.loads(self._stored.read_text()) if self._stored.exists() else []

    async def run(
        self,
        step: Step,
        seeds: int,
        restore: Callable[[], None] | None = None,
        among: Callable[[int], bool] = lambda _: True,
    ) -> Exploration:
        """`step` for seeds 1 to `seeds`. AssertionError if one fails. `restore` is called before each copy: puts back
        what lies outside of memory. `among`: which of the seeds belong to this snapshot.
        """
        new = range(1, max(1, round(seeds * self._factor)) + 1)
        wanted = [self._only] if self._only else [*self.stored, *(seed for seed in new if seed not in self.stored)]
        found = await explored(step, filter(among, wanted), restore, self._note)
        if self._factor > 1 and found.failed:
            SEEDS.mkdir(exist_ok=True)
            every = sorted({*self.stored, *(outcome.seed for outcome in found.failed)})
            self._stored.write_text(json.dumps(every) + "\n")
        found.check(f"python -m pytest {self._test}")
        return found

    def _note(self, outcome: Outcome) -> bool:
        if self._log:
            with Path(self._log).open("a") as log:
                log.write(json.dumps({"test": self._test} | asdict(outcome)) + "\n")
        return False


def at_once(work: Coroutine[object, None, Exploration]) -> Exploration:
    """The result of a coroutine that awaits nothing."""
    try:
        work.send(None)
    except StopIteration as result:
        return result.value
    raise AssertionError("it awaits something: use `run`")


async def explored(
    step: Step,
    seeds: Iterable[int],
    restore: Callable[[], None] | None = None,
    enough: Callable[[Outcome], bool] = lambda _: False,
) -> Exploration:
    """`step` in a copy for each seed, one after the other; ends early with the outcome that is `enough`."""
    found = Exploration()
    loop = asyncio._get_running_loop()
    for seed in seeds:
        if restore is not None:
            restore()
        faulthandler.cancel_dump_traceback_later()  # its thread does not come along into the copy
        child, pipe = fork()
        faulthandler.dump_traceback_later(4 * world.LONGEST if child else world.LONGEST, exit=True, file=2)
        if child:
            data, code = heard(child, pipe)
            outcome = pickle.loads(data) if data else Outcome(seed, f"the copy died: {code}", "", 0.0, 0.0)
            found.outcomes.append(outcome)
            if enough(outcome):
                break
            continue
        asyncio._set_running_loop(loop)
        signal.setitimer(signal.ITIMER_PROF, LONGEST)  # its default action ends the copy
        began, virtual = time.process_time(), primitives.world.now
        primitives.world.seed_with(seed)
        error, told = "", None
        try:
            doing = step(seed)
            told = await doing if inspect.isawaitable(doing) else doing
        except BaseException:  # noqa: BLE001 - told to the original
            last = "\n".join(primitives.world.history)
            error = f"{traceback.format_exc()}\nlast switches and frames:\n{last}"
        cpu, virtual = time.process_time() - began, primitives.world.now - virtual
        outcome = Outcome(seed, error, primitives.world.digest.hexdigest(), cpu, virtual, told)
        tell(pipe, partial(pickle.dumps, outcome))
    return found
