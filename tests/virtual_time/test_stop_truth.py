"""What is said of a stop within 1.2 s is the truth of the virtual machine, whatever lies between it and the drives."""

from collections import Counter
from functools import partial
from itertools import product
from pathlib import Path
from random import Random

import pytest

from tests.virtual_time.clock import Clock
from tests.virtual_time.explore import Explorer, Outcome, at_once
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.page import check_page
from tests.virtual_time.service import VirtualService, add_campaign
from tests.virtual_time.stops import CONDITIONS, WAYS, Stop, press_stop

CELLS = [*product(CONDITIONS, WAYS)]
SEEDS = 4  # of each cell
PART, PARTS = 0.5, 16  # s of the campaign's first 8 s, each part with a snapshot of its own


@pytest.mark.parametrize("machine", ["canopen", "modbus"], indirect=True)
def test_what_is_said_of_a_stop_is_the_truth(
    service: VirtualService, machine: VirtualMachine, clock: Clock, explore: Explorer, tmp_path: Path
) -> None:
    def step(seed: int) -> Stop:
        return press_stop(service, machine, clock, seed, *CELLS[seed % len(CELLS)], PART)

    service.client.start(add_campaign(service))
    outcomes: list[Outcome] = []
    for part in range(PARTS):
        restore = service.snapshot()
        mine = partial(_in_part, part)
        outcomes += at_once(explore.run(step, SEEDS * len(CELLS), restore=restore, among=mine)).outcomes
        restore()  # the original goes on with its own files
        clock.sleep(PART)
    stops = [outcome.told for outcome in outcomes if isinstance(outcome.told, Stop)]
    assert len(stops) < len(CELLS) or sum(stop.moved for stop in stops) > len(stops) / 3
    check_page([stop for stop in stops if stop.way == "both"], tmp_path)
    counted = Counter((stop.condition, stop.way, stop.summary) for stop in stops)
    print(*(f"{number:4} {' | '.join(cell)}" for cell, number in sorted(counted.items())), sep="\n")
    print(f"{len(stops)} stops in {sum(outcome.cpu for outcome in outcomes):.1f} CPU s")


def _in_part(part: int, seed: int) -> bool:
    return Random(f"part {seed}").randrange(PARTS) == part
