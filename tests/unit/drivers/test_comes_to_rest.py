"""Stop, close, cancel, refusals and trouble that meet: the drives lose their energy all the same, each of them."""

import asyncio
import threading
from collections.abc import AsyncGenerator, Awaitable, Callable
from dataclasses import replace

import pytest

from drivers.cia402.axis import Cia402Axis
from drivers.cia402.connection import DriveThread
from drivers.cia402.device import Abilities
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import Cia402Machine, Watched
from drivers.cia402.states import Controlword
from drivers.contract.bench import eventually
from drivers.errors import (
    CommunicationLost,
    DriveFault,
    EnvelopeLeft,
    StopNotConfirmed,
    SweepInterrupted,
    WrongConfiguration,
)
from drivers.ports import SampleBlock, SweepMode
from tests.unit.drivers.given import sweep
from tests.unit.drivers.small_servo import PATIENCE, Gate, Link, Servo, connected, machine


async def held_up() -> tuple[Cia402Machine, Link, Servo, Gate]:
    """A machine whose only axis has energy and does not tell its statusword until the gate is opened."""
    gate = Gate("statusword")
    port, link = machine(servo := Servo("joint_1", before=gate))
    await port.connect()
    await port.enable("joint_1")
    gate.shut()
    return port, link, servo, gate


async def test_closed_twice_at_once_it_is_closed_once_and_both_wait() -> None:
    port, link, servo, gate = await held_up()
    first, second = asyncio.create_task(port.close()), asyncio.create_task(port.close())
    await gate.reached()
    stop = asyncio.create_task(port.stop())  # a stop while closing waits for it, too
    await asyncio.sleep(0)
    assert [task.done() for task in (first, second, stop)] == [False, False, False]
    gate.open()
    await asyncio.wait_for(asyncio.gather(first, second, stop), PATIENCE)
    assert (link.opened, link.closed) == (1, 1)
    assert not servo.energised


async def test_a_closing_that_is_cancelled_goes_on_to_its_end() -> None:
    port, link, servo, gate = await held_up()
    closing = asyncio.create_task(port.close())
    await gate.reached()
    closing.cancel()
    with pytest.raises(asyncio.CancelledError):
        await closing
    gate.open()
    await asyncio.wait_for(port.close(), PATIENCE)
    assert not servo.energised
    assert link.closed == 1
    await port.connect()  # nothing of the old connection is in the way
    await port.close()
    assert (link.opened, link.closed) == (2, 2)


async def test_closing_survives_a_stop_that_failed_beside_it() -> None:
    port, link, servo, gate = await held_up()
    stop = asyncio.create_task(port.stop())
    await gate.reached()
    servo.before = lose
    closing = asyncio.create_task(port.close())
    await asyncio.sleep(0)
    gate.open()
    with pytest.raises(CommunicationLost):
        await asyncio.wait_for(stop, PATIENCE)
    await asyncio.wait_for(closing, PATIENCE)
    assert link.closed == 1


def lose(exchange: str) -> None:
    raise CommunicationLost(f"no answer to {exchange}")


async def test_who_waits_for_the_thread_when_it_is_closed_gets_an_answer_and_who_comes_later_an_error() -> None:
    thread, begun, go = DriveThread("test"), threading.Event(), threading.Event()

    def first() -> bool:
        begun.set()
        return go.wait(PATIENCE)

    under_way = asyncio.create_task(thread.run(first))
    assert await asyncio.to_thread(begun.wait, PATIENCE)
    waiting = asyncio.create_task(thread.run(int, "7"))
    await asyncio.sleep(0)
    closing = asyncio.create_task(thread.close())
    await asyncio.sleep(0)
    with pytest.raises(CommunicationLost, match="closed"):
        await thread.run(int, "8")
    go.set()
    assert await asyncio.wait_for(asyncio.gather(under_way, waiting), PATIENCE) == [True, 7]
    await asyncio.wait_for(closing, PATIENCE)


async def test_enabling_that_is_cancelled_leaves_no_axis_with_energy() -> None:
    gate = Gate("control 0F")
    silent, other = Servo("joint_1"), Servo("joint_2", before=gate)
    async with connected(silent, other) as (port, _):
        gate.shut()
        enabling = asyncio.create_task(port.enable("joint_1", "joint_2"))
        await gate.reached()
        assert silent.energised
        silent.before = lose
        enabling.cancel()
        gate.open()
        with pytest.raises(asyncio.CancelledError):  # and not the trouble of the first axis
            await asyncio.wait_for(enabling, PATIENCE)
        assert not other.energised
        assert silent.unheard


@pytest.mark.parametrize(
    ("refused", "missing"),  # what would confirm it
    [
        (("statusword", "motion"), "statusword"),
        (("motion",), "motion"),
        (("control 02", "motion"), "motion"),
        (("control 00",), "control 00"),
    ],
    ids=str,
)
async def test_a_refused_rung_does_not_keep_the_drive_from_the_next(refused: tuple[str, ...], missing: str) -> None:
    def refuse(exchange: str) -> None:
        if exchange in refused:
            raise WrongConfiguration(f"{exchange} refused")

    servo = Servo("joint_1")
    async with connected(servo) as (port, _):
        await port.enable("joint_1")
        servo.velocity, servo.before = 0.5, refuse
        with pytest.raises(StopNotConfirmed, match=f"joint_1: {missing} refused"):
            await port.stop()
        assert servo.unheard
        assert servo.told[-1] == 0 or missing == "control 00"
        assert not servo.energised
        servo.before = lambda _: None


async def test_an_axis_that_turns_without_energy_is_not_confirmed() -> None:
    servo = Servo("joint_1")
    async with connected(servo) as (port, _):
        control = servo.control

        def turning(controlword: int) -> None:  # under its weight, with its brake open
            control(controlword)
            servo.velocity = 0.5

        servo.control, servo.velocity = turning, 0.5
        with pytest.raises(StopNotConfirmed, match=r"turns at 0\.5 rad/s, standstill is at most 0\.001 rad/s"):
            await port.stop()
        servo.control = control
        assert await port.stop() == ("joint_1",)


@pytest.mark.parametrize(
    ("servo", "waits"),
    [(Servo("joint_1", acknowledges=False), 0x1F), (Servo("joint_1", ignored=Controlword.SWITCH_ON), 0x07)],
    ids=["set-point", "step"],
)
async def test_a_stop_does_not_wait_for_what_the_drive_does_not_take(
    monkeypatch: pytest.MonkeyPatch, servo: Servo, waits: int
) -> None:
    monkeypatch.setattr(Cia402Axis, "transition_timeout", 2 * PATIENCE)

    async def enable_and_move(port: Cia402Machine) -> None:
        await port.enable("joint_1")
        await port.move_to("joint_1", 0.5, 0.1)

    async with connected(servo) as (port, _):
        moving = asyncio.create_task(enable_and_move(port))
        await eventually(lambda: servo.told[-1] == waits)
        await asyncio.wait_for(port.stop(), PATIENCE)
        assert not servo.energised
        with pytest.raises(SweepInterrupted):
            await asyncio.wait_for(moving, PATIENCE)
        assert servo.told[-1] == Controlword.DISABLE_VOLTAGE
        await port.enable()  # what was stopped is over: the next is not


async def test_a_drive_side_sweep_that_goes_on_and_on_is_stopped() -> None:
    servo = Servo("joint_1", samples_a_look=200)
    async with connected(servo) as (port, _):
        await port.enable("joint_1")
        with pytest.raises(EnvelopeLeft, match="samples"):
            async for _ in port.run_sweep(sweep()):
                pass
        assert not servo.energised
        assert servo.recorded < 5000


WAYS: dict[str, Callable[[Cia402Machine], Awaitable[object]]] = {
    "stop": lambda port: port.stop(),
    "close": lambda port: port.close(),
    "disable": lambda port: port.disable("joint_2"),
}


@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
async def test_no_further_step_is_told_to_a_drive(way: Callable[[Cia402Machine], Awaitable[object]]) -> None:
    gate = Gate("control 07")
    first, second = Servo("joint_1"), Servo("joint_2", before=gate)
    async with connected(first, second) as (port, link):
        gate.shut()
        enabling = asyncio.create_task(port.enable("joint_1", "joint_2"))
        await gate.reached()
        assert first.energised
        asked = link.thread.asked
        ending = asyncio.ensure_future(way(port))
        await eventually(lambda: link.thread.asked > asked)  # and waits for it
        gate.open()
        with pytest.raises(SweepInterrupted, match="stopped while it was being enabled"):
            await asyncio.wait_for(enabling, PATIENCE)
        await asyncio.wait_for(ending, PATIENCE)
        assert Controlword.ENABLE_OPERATION not in second.told
        assert [first.energised, second.energised] == [False, False]


@pytest.mark.parametrize("stopped", [False, True])
async def test_a_drive_side_sweep_ends_while_its_consumer_hangs(stopped: bool) -> None:
    """By the fault of another axis, unless a person had stopped it."""
    moving, standing = Servo("joint_1", samples_a_look=5), Servo("joint_2")
    async with connected(moving, standing) as (port, _):
        await port.enable("joint_1")
        run = port.run_sweep(sweep(periods=1000))
        await anext(run)
        if stopped:
            await port.stop()
        standing.announced = 0x4310
        await eventually(lambda: not moving.energised)
        told = (SweepInterrupted, "sweep was stopped") if stopped else (DriveFault, r"joint_2 \(small\): error 4310h")
        with pytest.raises(told[0], match=told[1]):
            async for _ in run:
                pass


async def test_the_end_of_the_moving_axis_is_told_before_that_of_one_that_stands() -> None:
    standing, stop = Servo("joint_2", announced=0x4310), threading.Event()
    thread, axis = DriveThread("test"), Cia402Axis(standing, HostWatch(60.0))

    async def lose() -> None:
        async with Watched(thread, [axis], stop):
            await eventually(stop.is_set)
            raise CommunicationLost("the cable")

    with pytest.raises(CommunicationLost, match="the cable"):
        await lose()
    await thread.close()


class Streaming(Servo):
    """Takes set-points of the host; `log` has what it is asked, and the end of its stream."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.log: list[str] = []
        self.before = self.log.append

    def configure(self) -> Abilities:
        return replace(super().configure(), streams=True)


class Stream:
    """A run of one block, which goes on until it is told to stop and then takes its time to end."""

    streams = True

    def __init__(self, servo: Streaming, stop: threading.Event) -> None:
        self._servo, self._stop = servo, stop

    async def blocks(self) -> AsyncGenerator[SampleBlock, None]:
        yield self._servo.page(0, 1)
        await asyncio.Event().wait()

    def halt(self) -> None: ...

    async def interrupted(self) -> None: ...

    async def over(self) -> None:
        await eventually(self._stop.is_set)
        await asyncio.sleep(0)
        self._servo.log.append("the stream has ended")

    def timing(self) -> None: ...


@pytest.mark.parametrize("way", ["left", "cancelled"])
async def test_an_axis_is_brought_down_only_after_its_stream_has_ended(way: str) -> None:
    servo = Streaming("joint_1")
    async with connected(servo) as (port, link):

        async def stream(sweeps: object, stop: threading.Event) -> Stream:
            return Stream(servo, stop)

        link.stream = stream
        await port.enable("joint_1")
        run = port.run_sweep(sweep(mode=SweepMode.HOST_STREAMED, sample_rate=1 / link.sync_period))
        await anext(run)
        servo.log.clear()
        if way == "left":
            await run.aclose()
        else:
            consumer = asyncio.ensure_future(anext(run))
            await asyncio.sleep(0)
            consumer.cancel()
            with pytest.raises(asyncio.CancelledError):
                await consumer
            await eventually(lambda: not servo.energised)
        assert servo.log[0] == "the stream has ended"
        assert servo.log[-1] == "motion"  # and it was confirmed
        assert not servo.energised
