"""What only the CANopen adapter promises: configuration with read-back, and punctual cycles."""

import asyncio
import copy
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import can
import canopen
import pytest
from canopen.sdo.client import SdoClient

from drivers.canopen import frames
from drivers.canopen.device import MeasuringObject
from drivers.canopen.fieldbus import CanopenConnection
from drivers.canopen.profile import Entry
from drivers.canopen.streamed_axis import StreamedAxis
from drivers.cia402.connection import DriveThread
from drivers.cia402.device import MeasuringCommand
from drivers.cia402.machine import Cia402Machine
from drivers.contract.bench import closing, consume, eventually
from drivers.errors import MotionForbidden, WrongConfiguration, WrongIdentity
from drivers.ports import AxisState, DrivePort, SweepMode
from drivers.registry import open_drive
from tests.contract.bench import AXIS, DRIVES, SYNC_PERIOD, Virtual, noise, sweep

pytestmark = pytest.mark.adapter("canopen")
ENDLESS: dict[str, Any] = {"periods": 200, "offset_velocity": 0.002, "sines": ()}


def link_of(port: DrivePort) -> CanopenConnection:
    """The open connection behind a port."""
    assert isinstance(port, Cia402Machine)
    link = port._link  # pyright: ignore[reportPrivateUsage]  # nobody else may have it
    assert isinstance(link, CanopenConnection)
    return link


@contextmanager
def another_client(virtual: Virtual) -> Iterator[SdoClient]:
    """Somebody else with a commissioning tool on node 1."""
    bus = cast("dict[str, Any]", virtual.profile["bus"])
    where = {name: bus[name] for name in ("host", "port") if bus[name] is not None}
    with canopen.Network(can.Bus(interface=bus["interface"], channel=bus["channel"], **where)) as network:
        network.NOTIFIER_CYCLE = 0.05
        network.connect()
        sdo: SdoClient = network.add_node(1, str(DRIVES / "../eds/virtual-axis.eds")).sdo
        sdo.RESPONSE_TIMEOUT = 10.0  # s
        yield sdo


async def trespass_is_noticed_and_allowed(port: DrivePort) -> None:
    await port.status()  # its answers come behind all that the other had said
    position = (await port.status())[AXIS].position
    with pytest.raises(MotionForbidden, match=r"another host is on the bus: SDO request to node 1 \(COB-ID 601h\)"):
        await port.move_to(AXIS, position, 0.01)
    port.allow()
    await port.enable(AXIS)


async def test_a_mapping_that_somebody_changed_is_noticed_before_moving(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    with another_client(virtual) as sdo:
        sdo.download(0x1801, 1, (0x80000281).to_bytes(4, "little"))
    before = virtual.truth()["position"]
    with pytest.raises(WrongConfiguration, match=r"joint_1 \(node 1\): PDO mapping was changed"):
        await consume(port, await sweep(port, SweepMode.HOST_STREAMED))
    assert virtual.truth()["position"] == pytest.approx(before, abs=1e-4)
    assert virtual.energised() == []


async def test_limits_that_somebody_changed_are_put_right(port: DrivePort, virtual: Virtual, mode: SweepMode) -> None:
    await port.enable(AXIS)
    with another_client(virtual) as sdo:
        sdo.download(0x6072, 0, (1).to_bytes(2, "little"))  # 0.1 % of rated torque
        sdo.download(0x6085, 0, (1).to_bytes(4, "little"))  # quick stop in minutes
    await trespass_is_noticed_and_allowed(port)
    await consume(port, await sweep(port, mode, effort_limit=3000.0))
    with another_client(virtual) as sdo:  # one SDO channel: never two clients at a time
        assert int.from_bytes(sdo.upload(0x6072, 0), "little") == 999  # 3000 N m of rated 3000.02
        assert int.from_bytes(sdo.upload(0x6085, 0), "little") > 10**6
    assert (await port.status())[AXIS].state is AxisState.ENABLED


@pytest.mark.parametrize(
    ("place", "value", "error", "message"),
    [
        (("axes", 0, "rated_torque"), 20.0, WrongIdentity, "17.54 N m, the profile says 20 N m"),
        (("axes", 0, "identity", "revision"), 2, WrongIdentity, "revision is 00010000h, the profile says 00000002h"),
        (("maker_settings", 0, "index"), 0x2FFF, WrongConfiguration, "2FFFh:01 SYNC time-out in ms: .*does not exist"),
        (("stop_options", "quick_stop"), 77, WrongConfiguration, "605Ah:00 quick stop option = 77: .*too high"),
    ],
)
async def test_drives_that_do_not_fit_the_profile(
    virtual: Virtual, place: tuple[Any, ...], value: object, error: type[Exception], message: str
) -> None:
    profile: Any = copy.deepcopy(dict(virtual.profile)) | {"stop_options": {}}
    *way, last = place
    target = profile
    for part in way:
        target = target[part]
    target[last] = value
    async with closing(open_drive(profile, DRIVES)) as port:
        with pytest.raises(error, match=message):
            await port.connect()


async def test_the_cycle_is_paced_and_its_lateness_told(port: DrivePort) -> None:
    await port.enable(AXIS)
    command = await sweep(port, SweepMode.HOST_STREAMED)
    start = time.monotonic()
    await consume(port, command)
    took = time.monotonic() - start
    timing = port.set_point_timing
    assert timing is not None
    assert timing.cycles >= round(command.duration / SYNC_PERIOD)
    assert timing.median_lateness <= timing.worst_lateness
    if timing.source == "thread":  # the kernel makes up for a late stretch by an early one
        assert timing.median_lateness >= 0.0
        assert took >= (timing.cycles + timing.missed - 2) * SYNC_PERIOD  # a late cycle is never made up for in a burst


async def test_a_drive_that_refuses_a_rung_of_the_ladder_loses_its_energy_all_the_same(
    port: DrivePort, virtual: Virtual
) -> None:
    sdo = link_of(port).devices[AXIS].sdo
    write = sdo.write

    def refuse_abort(entry: Entry, value: float) -> None:
        if (entry, value) == (MeasuringObject.COMMAND, MeasuringCommand.ABORT):
            raise WrongConfiguration("abort 0800 0022h")  # e.g. the function ended by itself in this moment
        write(entry, value)

    sdo.write = refuse_abort
    await port.enable(AXIS)
    running = port.run_sweep(await sweep(port, SweepMode.DRIVE_SIDE, **ENDLESS))
    await anext(running)
    await port.stop()
    assert virtual.energised() == []
    await running.aclose()


async def test_a_speed_control_that_cannot_be_restored_costs_the_axis_its_energy(
    port: DrivePort, virtual: Virtual, caplog: pytest.LogCaptureFixture
) -> None:
    sdo = link_of(port).devices[AXIS].sdo
    write = sdo.write
    softened = False

    def stay_soft(entry: Entry, value: float) -> None:
        nonlocal softened
        if entry == MeasuringObject.GAIN and softened:
            raise WrongConfiguration("abort 0800 0022h")
        softened = softened or entry == MeasuringObject.GAIN
        write(entry, value)

    sdo.write = stay_soft
    await port.enable(AXIS)
    with pytest.raises(WrongConfiguration, match="0800 0022h"):
        await consume(port, await noise(port, periods=1))
    assert virtual.energised() == []
    with pytest.raises(WrongConfiguration, match="0800 0022h"):
        await port.enable(AXIS)
    assert virtual.energised() == []
    sdo.write = write
    await port.enable(AXIS)
    assert virtual.truth()["softened"] is False
    assert "joint_1 (node 1): speed control was left softened, now restored" in caplog.text


async def test_a_drive_that_is_lost_while_the_consumer_hangs_is_told_to_stop(port: DrivePort, virtual: Virtual) -> None:
    await port.enable(AXIS)
    running = port.run_sweep(await sweep(port, SweepMode.DRIVE_SIDE, **ENDLESS))
    await anext(running)  # and then a disk that takes its time
    virtual.order("silence", joint=AXIS, on=True)
    await eventually(lambda: virtual.energised() == [])
    virtual.order("silence", joint=AXIS, on=False)
    await running.aclose()


async def test_many_readers_of_the_status_are_not_ahead_of_a_stop(
    port: DrivePort, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, asked, most = DriveThread.run, 0, 0

    async def counted(self: DriveThread, function: Callable[..., object], *args: object) -> object:
        nonlocal asked, most
        asked += 1
        most = max(most, asked)
        try:
            return await run(self, function, *args)
        finally:
            asked -= 1

    monkeypatch.setattr(DriveThread, "run", counted)
    await asyncio.gather(*(port.status() for _ in range(30)))
    assert 1 <= most <= 2  # one under way, one that waits


async def test_a_stop_brings_every_axis_down_whatever_ended_the_stream(
    port: DrivePort, virtual: Virtual, monkeypatch: pytest.MonkeyPatch
) -> None:
    await port.enable(AXIS)
    running = port.run_sweep(await sweep(port, SweepMode.HOST_STREAMED, **ENDLESS))
    await anext(running)

    def fail(self: StreamedAxis, event: frames.Event) -> None:
        raise IndexError("unforeseen")

    monkeypatch.setattr(StreamedAxis, "take", fail)
    await eventually(lambda: not any(thread.name.startswith("can-stream") for thread in threading.enumerate()))
    await port.stop()
    assert virtual.energised() == []
    with pytest.raises(IndexError):
        async for _ in running:
            pass
