"""Whatever happens, in whatever order and at whatever moment: nothing moves unasked, nothing is lost or counted twice.

A few steps of `tests/soak`; ``make soak`` takes each of its disturbances twenty times.
"""

import random
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from drivers.canopen.socketcand import SocketcandBus
from tests.soak.walk import WAYS, Way, of, walking
from tests.soak.watch import Watch
from tests.system.rest_bench import VirtualMachine, until, virtual_machine
from tests.system.virtual_bench import Host

STEPS = 3
PROFILE_POSITION = 1  # 6060h


def seed_of_the_commit() -> int:
    """The same again for the same commit; 0 without git."""
    found = subprocess.run(["git", "rev-parse", "HEAD"], cwd=Path(__file__).parent, capture_output=True, text=True)
    return int(found.stdout[:5] or "0", 16)


@pytest.mark.parametrize("way", WAYS.values(), ids=list(WAYS))
def test_nothing_moves_unasked_and_nothing_is_lost(tmp_path: Path, way: Way) -> None:
    seed = seed_of_the_commit()
    told = [f"python -m tests.soak {way.name} --seed {seed}"]
    with walking(way, tmp_path, seed, told.append) as (walk, watch):
        for disturbance in random.Random(seed).sample(of(way), STEPS):
            walk.disturb(disturbance)
        walk.finish()
    assert (watch.unasked, walk.tally.broken) == ([], []), "\n".join(told)
    assert walk.tally.done.total() == STEPS
    assert walk.tally.sweeps >= 1


@pytest.fixture
def machine(tmp_path: Path) -> Iterator[VirtualMachine]:
    with virtual_machine(tmp_path, 1.0) as machine:
        yield machine


@pytest.fixture
def stranger(machine: VirtualMachine) -> Iterator[Host]:
    """Somebody on the bus who asks nobody."""
    line = yaml.safe_load(machine.profile.read_text("utf-8"))["bus"]
    with SocketcandBus("can0", line["host"], line["port"]) as bus:
        yield Host(bus)


def test_the_watch_sees_energy_that_nobody_gave_leave_for(machine: VirtualMachine, stranger: Host) -> None:
    with Watch(machine) as watch:
        stranger.enable(2, PROFILE_POSITION)
        until(lambda: watch.unasked, "seen")
    assert [(each.joint, each.what, each.after) for each in watch.unasked] == [
        ("joint_2", "has energy", "before the first start")
    ]


def test_the_watch_sees_an_axis_that_gets_energy_while_all_come_to_rest(
    machine: VirtualMachine, stranger: Host
) -> None:
    with Watch(machine) as watch:
        watch.may_move()
        stranger.enable(1, PROFILE_POSITION)
        until(lambda: machine.axes()["joint_1"]["energised"], "it has energy")
        watch.must_rest("STOP")
        until(lambda: watch.ends_for(1.0), "the watch has looked for a while")
        assert watch.unasked == []  # joint_1 has not come to rest, and got nothing
        stranger.enable(2, PROFILE_POSITION)
        until(lambda: watch.unasked, "seen")
        assert not watch.rests_now
    assert [(each.joint, each.what, each.after) for each in watch.unasked] == [("joint_2", "got energy", "STOP")]


def test_the_watch_has_nothing_against_what_was_asked_for(machine: VirtualMachine, stranger: Host) -> None:
    with Watch(machine) as watch:
        watch.may_move()
        stranger.enable(1, PROFILE_POSITION)
        until(lambda: machine.axes()["joint_1"]["energised"], "it has energy")
        watch.must_rest("STOP")
        stranger.write(1, 0x6040, 0, "H", 0)
        until(lambda: watch.rests_now, "it rests")
        assert len(watch.rests) == 1
    assert watch.unasked == []
