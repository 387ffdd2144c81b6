"""What the suite knows of a machine under test, and the motions that it asks for."""

import asyncio
import time
from collections.abc import AsyncGenerator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.ports import DrivePort, NoiseCommand, SampleBlock, Sine, SweepCommand, SweepMode


@dataclass(frozen=True, kw_only=True)
class Bench:
    """What there is to test with; rad, rad/s, N m.

    The suite moves `axis` between -0.2 and 2 rad at up to 1 rad/s, and slowly by a few hundredths of a rad from where
    it stands.
    """

    modes: frozenset[SweepMode]
    orders: frozenset[str]  # that `Machine.order` takes, as far as this drive can have the trouble
    axis: str
    other: str | None = None  # a second axis; what needs one is left out where there is none
    injects: bool = False  # torque noise
    exclusive: bool = False  # one host at a time
    load_encoder: bool = False  # its position comes with the samples of drive-side sweeps
    position_limits: tuple[float, float]  # of the axis, as in the profile
    velocity_limit: float  # the same
    effort: float  # limit of the suite's sweeps; the axis' own lies between it and 1.8 times it
    slow_effort: tuple[float, float]  # between which the mean effort of a slow turn forward lies
    least_effort: float  # less than a slow turn takes
    drive_rate: float = 250.0  # Hz, samples of drive-side sweeps
    sync_period: float = 0.008  # s, of host-streamed sweeps
    amplitude: float = 0.002  # rad/s, of the sines of the suite's sweeps
    least_sine: float = 0.0  # rad, that a sine must have for the drive to resolve it

    @property
    def both(self) -> tuple[str, ...]:
        """The axis, and the second one if there is one."""
        return (self.axis,) if self.other is None else (self.axis, self.other)

    def rate(self, mode: SweepMode) -> float:
        """Samples a second of a sweep."""
        return 1 / self.sync_period if mode is SweepMode.HOST_STREAMED else self.drive_rate

    async def sweep(self, port: DrivePort, mode: SweepMode, periods: int = 2, **changes: Any) -> SweepCommand:
        """A short sweep from where the axis stands, with a window around that."""
        start = (await port.status())[self.axis].position
        command = SweepCommand(
            joint=self.axis,
            mode=mode,
            offset_velocity=0.0105,
            sines=(Sine(2.0, self.amplitude, 0.3), Sine(4.0, self.amplitude, 1.1)),
            period=0.5,
            periods=periods,
            ramp=0.2,
            settle=0.2,
            sample_rate=self.rate(mode),
            velocity_limit=0.05,
            effort_limit=self.effort,
            position_window=(start - 0.5, start + 0.5),
        )
        return replace(command, **changes)

    async def noise(self, port: DrivePort, periods: int = 4, **changes: Any) -> NoiseCommand:
        """A short noise run from where the axis stands, 2 to 40 Hz."""
        start = (await port.status())[self.axis].position
        command = NoiseCommand(
            joint=self.axis,
            offset_velocity=0.0105,
            effort=0.012 * self.effort,
            lowest=2.0,
            highest=40.0,
            period=0.5,
            periods=periods,
            seed=7,
            softening=0.5,
            ramp=0.2,
            settle=0.2,
            sample_rate=self.drive_rate,
            velocity_limit=0.1,
            effort_limit=self.effort,
            position_window=(start - 0.5, start + 0.5),
        )
        return replace(command, **changes)


class Machine(Protocol):
    """A machine that runs, seen past its port: what it really does, and troubles to order."""

    @property
    def bench(self) -> Bench: ...

    @property
    def profile(self) -> Mapping[str, object]:
        """The drive profile, with `joint` and `identity.product` of each of its `axes`."""
        ...

    def open(self) -> DrivePort:
        """A new port, not yet connected."""
        ...

    def truth(self, joint: str) -> Mapping[str, Any]:
        """`position`, rad, `velocity`, rad/s, and `fault`, 0 if there is none, of an axis."""
        ...

    def energised(self) -> list[str]:
        """The axes that have energy now."""
        ...

    def order(self, order: str, **fields: Any) -> Mapping[str, Any]:
        """A trouble of `Bench.orders`; docs/how-to/write-a-drive-adapter.md has what each does."""
        ...

    def recover(self) -> None:
        """Takes back every trouble that lasts; faults stay until they are acknowledged."""
        ...


async def consume(
    port: DrivePort, command: SweepCommand | NoiseCommand, each: Callable[[SampleBlock], object] = lambda _: None
) -> None:
    """Run a sweep or noise to its end, calling `each` with every block."""
    run = port.run_noise(command) if isinstance(command, NoiseCommand) else port.run_sweep(command)
    async for block in run:
        each(block)


@asynccontextmanager
async def closing(port: DrivePort) -> AsyncGenerator[DrivePort]:
    """Closed in any case: an open one is the trouble of every test after it."""
    try:
        yield port
    finally:
        await port.close()


async def eventually(condition: Callable[[], bool], within: float = 20.0) -> None:
    """Wait for a condition, s."""
    deadline = time.monotonic() + within
    while not condition():
        assert time.monotonic() < deadline, "condition never came true"
        await asyncio.sleep(0.01)


def column(blocks: list[SampleBlock], name: str) -> NDArray[np.float64]:
    """One column of all blocks."""
    return np.concatenate([getattr(block, name) for block in blocks])
