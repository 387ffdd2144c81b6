"""The gate before each word of motion: shut by a gap of the host's time, by another host, and by nobody's energy."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager

import pytest

from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import Cia402Machine
from drivers.cia402.states import Controlword, PowerState
from drivers.contract.bench import consume, eventually
from drivers.errors import MotionForbidden
from drivers.ports import SineCommand
from tests.unit.drivers.given import sweep
from tests.unit.drivers.small_servo import Servo, connected, machine

LIMIT = 0.05  # s
LOST = r"joint_1 \(small\) is 'switch on disabled', but this service did not disable it: find out what did"
STEPS = ("control 06", "control 07", "control 0F", "control 1F")
COMMAND = sweep(SineCommand(2.0, 0.01, 0.0), offset_velocity=0.02, periods=2)


def miss(watch: HostWatch) -> None:
    """Nothing of this process shows life for longer than allowed."""
    over = time.monotonic() + 2 * LIMIT
    while time.monotonic() < over:
        pass


def test_a_gap_shuts_the_gate_until_a_person_opens_it() -> None:
    watch, told = HostWatch(LIMIT), list[str]()
    watch.tell_to(lambda cause: told.append(str(cause)))
    miss(watch)
    watch.check()  # nobody has shown life yet
    watch.alive()
    watch.check()
    miss(watch)
    for _ in range(3):
        with pytest.raises(MotionForbidden, match=r"the host was suspended for 0\.\d s, limit 0\.05 s"):
            watch.check()
    watch.alive()
    assert watch.reason  # life alone opens nothing
    assert len(told) == 1
    miss(watch)
    watch.alive()
    assert len(told) == 2  # another gap, whatever is done about the first, found by who shows life first after it
    assert watch.woke <= time.monotonic()
    watch.allow()
    watch.check()


def test_the_first_that_was_seen_is_told_and_what_follows_is_not() -> None:
    watch, told = HostWatch(60.0), list[str]()
    watch.tell_to(lambda cause: told.append(str(cause)))
    watch.seen("SYNC of another")
    watch.seen("NMT of another")
    assert told == [watch.reason] == ["SYNC of another"]
    watch.allow()
    watch.seen("NMT of another")
    assert told[1:] == ["NMT of another"]
    watch.tell_to(lambda cause: told.append(str(cause)))  # who asks late is told as well
    assert told[1:] == ["NMT of another"] * 2


@asynccontextmanager
async def watched(
    servo: Servo, *, before: Callable[[HostWatch], None] = lambda _: None
) -> AsyncGenerator[tuple[Cia402Machine, HostWatch, list[str]]]:
    """A connected machine, its watch, and the causes that it tells. `before`: the first connection."""
    port, link = machine(servo)
    told: list[str] = []
    port.watch(lambda cause: told.append(str(cause)))
    before(link.watch)
    await port.connect()
    yield port, link.watch, told
    port.watch(None)
    await port.close()


def enabling(servo: Servo) -> list[int]:
    kinds = (Controlword.SHUTDOWN, Controlword.SWITCH_ON, Controlword.ENABLE_OPERATION)
    return [word for word in servo.told if word & 0x0F in kinds]


async def enable_and_move(port: Cia402Machine) -> None:
    await port.enable("joint_1")
    await port.move_to("joint_1", 0.0, 0.1)


@pytest.mark.parametrize("step", STEPS)
async def test_each_word_that_closes_the_loop_or_moves_is_asked_for(step: str) -> None:
    """The gap comes while the drive takes the word before it."""
    servo = Servo("joint_1")
    async with connected(servo) as (port, link):

        def wake(what: str) -> None:
            if what == step:
                link.watch.seen("the host was suspended")

        servo.before = wake
        with pytest.raises(MotionForbidden):
            await enable_and_move(port)
        words = enabling(servo)
        assert f"control {words[-1]:02X}" == step  # none after it
        assert not servo.energised
        with pytest.raises(MotionForbidden):
            await port.enable("joint_1")
        assert enabling(servo) == words
        servo.before = lambda _: None
        port.allow()
        await port.enable("joint_1")


async def test_a_measuring_function_is_not_started_either() -> None:
    servo = Servo("joint_1")
    async with connected(servo) as (port, link):
        await port.enable("joint_1")
        link.watch.seen("the host was suspended")
        with pytest.raises(MotionForbidden):
            await anext(port.run_sweep(COMMAND))
        assert servo.recorded == 0
        assert not servo.energised


async def test_a_gap_before_the_first_connection_counts_and_no_connection_clears_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("tests.unit.drivers.small_servo.HOST_TIMEOUT", LIMIT)
    async with watched(Servo("joint_1"), before=miss) as (port, _, told):
        for _ in range(2):
            with pytest.raises(MotionForbidden, match="suspended"):
                await port.enable("joint_1")
            assert "the host was suspended" in told[0]
            await port.close()
            await port.connect()


@pytest.mark.parametrize("state", [PowerState.SWITCHED_ON, PowerState.OPERATION_ENABLED])
async def test_an_axis_that_nobody_here_enabled_is_told(state: PowerState) -> None:
    servo = Servo("joint_1")
    async with watched(servo) as (port, _, told):
        servo.state = state
        await eventually(lambda: bool(told))
        assert told == [f"joint_1 (small) is '{state.value}', but this service did not enable it: find out what did"]
        with pytest.raises(MotionForbidden):
            await port.enable("joint_1")
        await port.stop()


@pytest.mark.parametrize("motion", ["move", "sweep"])
async def test_energy_that_nobody_here_took_is_missed(motion: str) -> None:
    servo = Servo("joint_1", samples_a_look=5)
    async with watched(servo) as (port, _, told):
        await port.enable("joint_1")
        moving = asyncio.create_task(port.move_to("joint_1", 0.5, 0.1) if motion == "move" else consume(port, COMMAND))
        await eventually(lambda: any(word & Controlword.NEW_SET_POINT for word in servo.told) or servo.recorded > 0)
        servo.state = PowerState.SWITCH_ON_DISABLED
        with pytest.raises(MotionForbidden, match=LOST):
            await moving
        assert len(told) == 1
        with pytest.raises(MotionForbidden, match=LOST):
            await port.enable("joint_1")
