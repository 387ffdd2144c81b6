"""One side dies by SIGKILL in the middle of a sweep: the other must notice, and the axes must stand."""

import asyncio
import json
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import cast

import pytest

from drivers.contract.bench import closing, consume, needs
from drivers.errors import CommunicationLost
from drivers.ports import AxisState, SweepMode
from drivers.registry import open_drive
from tests.contract.bench import AXIS, DRIVES, ROOT, Virtual

HOST = """
import asyncio, json, sys
from pathlib import Path
from drivers.ports import NoiseCommand, SineCommand, SweepCommand, SweepMode
from drivers.registry import open_drive

async def main() -> None:
    port = open_drive(json.loads(sys.argv[1]), Path(sys.argv[2]))
    await port.connect()
    await port.enable("joint_1")
    turn = dict(
        joint="joint_1", offset_velocity=0.002, period=1.0, periods=200, ramp=0.5, settle=0.5, sample_rate=250.0,
        velocity_limit=0.05, effort_limit=3000.0, position_window=(-2.0, 2.0),
    )
    if sys.argv[3] == "noise":
        run = port.run_noise(NoiseCommand(effort=30.0, lowest=1.0, highest=40.0, seed=3, softening=0.5, **turn))
    else:
        run = port.run_sweep(SweepCommand(mode=SweepMode(sys.argv[3]), sines=(SineCommand(2.0, 0.001, 0.0),), **turn))
    async for block in run:
        print("moving", flush=True)

asyncio.run(main())
"""


@contextmanager
def moving_host(profile: Mapping[str, object], how: str) -> Iterator["subprocess.Popen[bytes]"]:
    """A process whose axis moves."""
    command = [sys.executable, "-c", HOST, json.dumps(profile), str(DRIVES), how]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT) as host:
        assert host.stdout is not None
        assert host.stdout.readline() == b"moving\n"
        yield host


def wait_until_off(virtual: Virtual) -> None:
    deadline = time.monotonic() + 60.0
    while virtual.energised():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_axes_stand_after_the_host_was_killed(mortal: Virtual, mode: SweepMode) -> None:
    with moving_host(mortal.profile, mode.value) as host:
        assert mortal.energised() == [AXIS]
        host.send_signal(signal.SIGKILL)
    wait_until_off(mortal)
    assert mortal.truth()["velocity"] == pytest.approx(0.0, abs=1e-3)


@needs(injects=True)
def test_the_drive_restores_its_speed_control_after_the_host_was_killed_in_a_noise_run(mortal: Virtual) -> None:
    with moving_host(mortal.profile, "noise") as host:
        before = mortal.truth()
        host.send_signal(signal.SIGKILL)
    assert (before["energised"], before["softened"]) == (True, True)
    wait_until_off(mortal)
    after = mortal.truth()
    assert after["velocity"] == pytest.approx(0.0, abs=1e-3)
    assert after["softened"] is False


@needs(injects=True)
def test_connect_restores_the_speed_control_that_a_killed_host_left_soft(
    mortal: Virtual, caplog: pytest.LogCaptureFixture
) -> None:
    """The next host is there before the drive misses the first one: the drive itself has noticed nothing."""
    bus = {**cast("dict[str, object]", mortal.profile["bus"]), "host_timeout": 60.0}
    profile = {**mortal.profile, "bus": bus, "travel_limits": {"rad": 1e3}}
    with moving_host(profile, "noise") as host:
        host.send_signal(signal.SIGKILL)
    assert mortal.truth()["softened"] is True
    assert mortal.energised() == [AXIS]

    async def connect() -> None:
        async with closing(open_drive(profile, DRIVES)) as port:
            await port.connect()
            assert mortal.energised() == []
            assert mortal.truth()["softened"] is False

    asyncio.run(connect())
    assert "joint_1 (node 1): speed control was left softened, now restored: active gain" in caplog.text


def test_axes_stand_after_the_host_hung_and_nothing_resumes(mortal: Virtual, mode: SweepMode) -> None:
    with moving_host(mortal.profile, mode.value) as host:
        host.send_signal(signal.SIGSTOP)
        wait_until_off(mortal)
        host.send_signal(signal.SIGCONT)
        _, errors = host.communicate(timeout=60)
    assert host.returncode == 1
    # python-can may add a word of its own while the interpreter ends
    assert any(line.startswith("drivers.errors.") for line in errors.decode().splitlines()), errors.decode()
    assert mortal.energised() == []


async def test_a_machine_that_dies_is_lost_communication(mortal: Virtual, mode: SweepMode) -> None:
    async with closing(mortal.open()) as port:
        await port.connect()
        await port.enable(AXIS)
        command = await mortal.bench.sweep(port, mode, periods=200, offset_velocity=0.002, sines=())
        process = mortal.process
        assert process is not None
        with pytest.raises(CommunicationLost):
            await consume(port, command, lambda _: process.kill())
        status = await port.status()
        assert {axis.state for axis in status.values()} == {AxisState.UNKNOWN}
        with pytest.raises(CommunicationLost) as told:
            await port.enable(AXIS)
        assert "\n" not in str(told.value)  # an operator reads it
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("can-")]
    assert len(asyncio.all_tasks()) == 1


@needs(modes={SweepMode.HOST_STREAMED})
def test_a_busy_moment_of_the_machine_or_the_host_ends_no_streamed_sweep(mortal: Virtual) -> None:
    """Both share a computer, and neither it nor its owner says when it is busy.

    Where the kernel sends the set-points that the host planned, a host that plans no more ends the sweep, as it must.
    """
    assert mortal.process is not None
    with moving_host(mortal.profile, SweepMode.HOST_STREAMED.value) as host:
        for busy, seconds in ((mortal.process, 0.3), *(() if mortal.bench.vcan else ((host, 0.6),))):
            before = mortal.order("status")["sync_counter"]
            busy.send_signal(signal.SIGSTOP)
            time.sleep(seconds)
            busy.send_signal(signal.SIGCONT)
            while mortal.order("status")["sync_counter"] < before + 500:
                assert mortal.energised() == [AXIS]
                time.sleep(0.02)
            assert host.poll() is None
        host.kill()
    wait_until_off(mortal)
