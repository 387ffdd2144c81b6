"""A machine without physics: a `DrivePort` whose samples come from a formula, and that can be told to misbehave."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Mapping
from dataclasses import replace

import numpy as np

from drivers.errors import Cause, DriveError, NotReady, SweepInterrupted
from drivers.ports import (
    AxisIdentity,
    AxisState,
    AxisStatus,
    Capabilities,
    ChannelTiming,
    Fault,
    NoiseCommand,
    SampleBlock,
    SetPointTiming,
    StopSender,
    SweepCommand,
    SweepMode,
)

INERTIA, VISCOUS = 200.0, 150.0  # kg m^2, N m s/rad
BLOCK = 250  # samples


class FormulaDrive:
    """Rigid axes, one inertia. `trace` tells in order what was asked of the machine.

    `hold`: the sweep waits before its block of that number until it is stopped, or `go` is set.
    `fail`: raised at the block of that number. `skip`: sample left out. `silent`: it was switched off and on.
    """

    def __init__(self, joints: tuple[str, ...]) -> None:
        self.joints = joints
        self.trace: list[str] = []
        self.energised: set[str] = set()
        self.position = dict.fromkeys(joints, 0.0)
        self.hold: int | None = None
        self.fail: dict[int, DriveError] = {}
        self.skip: int | None = None
        self.silent = False  # until it is connected anew
        self.stop_error: DriveError | None = None
        self.holding = asyncio.Event()
        self.go = asyncio.Event()
        self._stopped = asyncio.Event()
        self.allowed = 0
        self.tell: Callable[[Cause], None] | None = None
        self.capabilities = Capabilities(frozenset(SweepMode), True, True, True, True, True, "none", 1)
        self.channel_timing: Mapping[str, ChannelTiming] = {joint: ChannelTiming() for joint in joints}
        self.set_point_timing: SetPointTiming | None = None

    async def connect(self) -> tuple[AxisIdentity, ...]:
        self.trace.append("connect")
        self.silent = False
        return tuple(AxisIdentity(joint, f"node {n}", 1, 2, 3, n, "0" * 64) for n, joint in enumerate(self.joints, 1))

    async def close(self) -> None:
        self.energised.clear()
        self.trace.append("close")

    async def status(self) -> Mapping[str, AxisStatus]:
        return {joint: self._status(joint) for joint in self.joints}

    def _status(self, joint: str) -> AxisStatus:
        energised = joint in self.energised
        state = AxisState.UNKNOWN if self.silent else AxisState.ENABLED if energised else AxisState.DISABLED
        return AxisStatus(joint, state, self.position[joint], 0.0, 0.0, None, not self.silent, energised)

    async def enable(self, *joints: str) -> None:
        if self.energised:
            raise NotReady(f"{self.energised} has energy already")
        self._stopped.clear()
        await asyncio.sleep(0)
        self.energised.update(joints)
        self.trace.append(f"enable {' '.join(joints)}")

    async def disable(self, joint: str) -> None:
        self.energised.discard(joint)
        self.trace.append(f"disable {joint}")

    async def move_to(self, joint: str, position: float, velocity: float) -> None:
        if joint not in self.energised:
            raise NotReady(f"{joint} has no energy")
        self.position[joint] = position
        self.trace.append(f"move {joint} {position:g}")

    async def run_noise(self, command: NoiseCommand) -> AsyncGenerator[SampleBlock, None]:
        raise NotReady(f"{command.joint}: no noise of its own")  # as its capabilities say
        yield

    async def run_sweep(self, *commands: SweepCommand) -> AsyncGenerator[SampleBlock, None]:
        joints = [command.joint for command in commands]
        if not self.energised.issuperset(joints):
            raise NotReady(f"{', '.join(joints)}: no energy")
        self.trace.append(f"sweep {' '.join(joints)}")
        together = [self.samples(command) for command in commands]
        try:
            for number, start in enumerate(range(0, len(together[0].index), BLOCK)):
                if number in self.fail:
                    raise self.fail[number]
                if number == self.hold:
                    self.holding.set()
                    await asyncio.wait(
                        waiting := [asyncio.create_task(event.wait()) for event in (self._stopped, self.go)],
                        return_when=asyncio.FIRST_COMPLETED,
                    )
                    for task in waiting:
                        task.cancel()
                if self._stopped.is_set():
                    raise SweepInterrupted(f"{', '.join(joints)}: sweep was stopped")
                for samples in together:
                    yield _part(samples, slice(start, start + BLOCK))
                await asyncio.sleep(0)
        finally:
            self.trace.append("standstill")

    def watch(self, tell: Callable[[Cause], None] | None) -> None:
        self.tell = tell

    def allow(self) -> None:
        self.allowed += 1

    def halt(self) -> None:
        self._stopped.set()

    async def stop(self) -> tuple[str, ...]:
        self._stopped.set()
        self.energised.clear()
        self.trace.append("stop")
        if self.stop_error is not None:
            raise self.stop_error
        return self.joints

    def stop_sender(self) -> StopSender:
        raise NotReady("there is no bus")

    async def faults(self) -> tuple[Fault, ...]:
        return ()

    async def acknowledge(self, joint: str) -> None:
        self.trace.append(f"acknowledge {joint}")

    def samples(self, command: SweepCommand) -> SampleBlock:
        rate = command.sample_rate
        index = np.arange(round(command.duration * rate))
        index = index[index != self.skip]
        time = index / rate
        velocity = np.full(len(time), command.offset_velocity)
        acceleration = np.zeros(len(time))
        for sine in command.sines:
            angle = 2 * np.pi * sine.frequency * (time - command.measure_from) + sine.phase
            velocity += sine.amplitude * np.sin(angle)
            acceleration += 2 * np.pi * sine.frequency * sine.amplitude * np.cos(angle)
        noise = np.random.default_rng(1).normal(0.0, 1.0, len(time))
        effort = INERTIA * acceleration + VISCOUS * velocity + noise
        position = self.position[command.joint] + np.cumsum(velocity) / rate
        return SampleBlock(command.joint, index, time, effort, velocity, position, velocity)


def _part(samples: SampleBlock, part: slice) -> SampleBlock:
    names = ("index", "time", "effort", "velocity", "position", "velocity_setpoint")
    return replace(samples, **{name: getattr(samples, name)[part] for name in names})
