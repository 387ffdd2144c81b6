"""The one gate to motion: who has it, what it asks, and how it leaves the machine."""

import asyncio

import pytest

from drivers.errors import CommunicationLost, StopNotConfirmed
from service.model.errors import Conflict, EnvelopeViolation
from service.planning.safety.envelope import Envelope
from tests.unit.service.campaigns.conftest import Bench, command

pytestmark = pytest.mark.slow

HOME = (0.0,) * 6


@pytest.fixture
async def connected(bench: Bench) -> Bench:
    await bench.machine.connect()
    bench.drive.trace.clear()
    return bench


async def test_nobody_moves_a_machine_that_nobody_uses(connected: Bench, envelope: Envelope) -> None:
    with pytest.raises(Conflict, match="the machine is not reserved"):
        async with connected.machine.motion(envelope, connected.intention):
            pass
    assert connected.drive.trace == []


async def test_an_axis_has_energy_while_it_moves_and_no_longer(connected: Bench, envelope: Envelope) -> None:
    with connected.machine.used_by("a test", connected.intention):
        async with (
            connected.machine.motion(envelope, connected.intention) as motion,
            motion.moving("joint_1", HOME, 0.1, 0.05) as go,
        ):
            await go(0.05)
            await go(0.1)
    assert connected.drive.trace == ["enable joint_1", "move joint_1 0.05", "move joint_1 0.1", "disable joint_1"]


async def test_only_the_way_that_was_checked(connected: Bench, envelope: Envelope) -> None:
    with (
        connected.machine.used_by("a test", connected.intention),
        pytest.raises(Conflict, match=r"target 0\.2 is outside the checked range 0 to 0\.1"),
    ):
        async with (
            connected.machine.motion(envelope, connected.intention) as motion,
            motion.moving("joint_1", HOME, 0.1, 0.05) as go,
        ):
            await go(0.2)
    assert connected.drive.trace == ["enable joint_1", "stop"]
    assert connected.drive.energised == set()


async def test_what_the_envelope_forbids_gets_no_energy(connected: Bench, envelope: Envelope) -> None:
    with connected.machine.used_by("a test", connected.intention):
        with pytest.raises(EnvelopeViolation, match="joint_1: target"):
            async with (
                connected.machine.motion(envelope, connected.intention) as motion,
                motion.moving("joint_1", HOME, 99.0, 0.05),
            ):
                pass
        far = command(connected.store.sweeps(connected.campaign.id)[0])
        with pytest.raises(EnvelopeViolation):
            async with (
                connected.machine.motion(envelope, connected.intention) as motion,
                motion.sweeping([far], (1.0, *HOME[1:])),
            ):
                pass
    assert "enable joint_1" not in connected.drive.trace


async def test_a_stop_is_asked_for_before_each_motion(connected: Bench, envelope: Envelope) -> None:
    async def move() -> None:
        async with (
            connected.machine.motion(envelope, connected.intention) as motion,
            motion.moving("joint_1", HOME, 0.1, 0.05) as go,
        ):
            await go(0.05)
            await connected.machine.stop("a person", "look")
            await go(0.1)

    with (
        connected.machine.used_by("a test", connected.intention),
        pytest.raises(Conflict, match="stopped by a person: look"),
    ):
        await move()
    assert connected.drive.trace == ["enable joint_1", "move joint_1 0.05", "stop", "stop"]


async def test_it_is_of_no_use_after_its_block(connected: Bench, envelope: Envelope) -> None:
    with connected.machine.used_by("a test", connected.intention):
        async with connected.machine.motion(envelope, connected.intention) as motion:
            pass
        with pytest.raises(Conflict, match="the permission to move has ended"):
            async with motion.moving("joint_1", HOME, 0.1, 0.05):
                pass
    assert connected.drive.trace == []


@pytest.mark.parametrize(
    "error", [CommunicationLost("bus-off"), KeyError("nobody thought of it"), asyncio.CancelledError()]
)
async def test_whatever_ends_it_leaves_every_axis_without_energy(
    connected: Bench, envelope: Envelope, error: BaseException
) -> None:
    connected.drive.stop_error = StopNotConfirmed([], {"joint_1": "mute"})

    async def move() -> None:
        async with (
            connected.machine.motion(envelope, connected.intention) as motion,
            motion.moving("joint_1", HOME, 0.1, 0.05),
        ):
            assert connected.drive.energised == {"joint_1"}
            raise error

    with connected.machine.used_by("a test", connected.intention), pytest.raises(type(error)) as raised:
        await move()
    assert raised.value is error
    assert connected.drive.trace[-1] == "stop"
    assert connected.drive.energised == set()
    assert "the stop is not confirmed" in raised.value.__notes__[0]
    assert "the stop is not confirmed" in connected.machine.trouble


async def test_cancelled_while_it_is_brought_down_it_comes_down_all_the_same(
    connected: Bench, envelope: Envelope, monkeypatch: pytest.MonkeyPatch
) -> None:
    stopping, go_on, stop = asyncio.Event(), asyncio.Event(), connected.drive.stop

    async def slow() -> tuple[str, ...]:
        stopping.set()
        await go_on.wait()
        return await stop()

    monkeypatch.setattr(connected.drive, "stop", slow)

    async def move() -> None:
        with connected.machine.used_by("a test", connected.intention):
            async with (
                connected.machine.motion(envelope, connected.intention) as motion,
                motion.moving("joint_1", HOME, 0.1, 0.05),
            ):
                raise LookupError

    moving = asyncio.create_task(move())
    await stopping.wait()
    moving.cancel()
    await asyncio.sleep(0)
    assert not moving.done()
    go_on.set()
    await asyncio.wait([moving])
    assert moving.cancelled()
    assert connected.drive.energised == set()
