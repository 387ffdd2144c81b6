"""Properties of a machine under test, what a test needs of it, the motions and fixtures of the suite."""

import asyncio
import threading
import time
from collections.abc import AsyncGenerator, Callable, Mapping, Set
from contextlib import asynccontextmanager
from dataclasses import dataclass, replace
from typing import Any, Protocol, TypeVar

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.ports import DrivePort, NoiseCommand, SampleBlock, SineCommand, SweepCommand, SweepMode


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Properties of the machine for the tests; rad, rad/s, N m.

    The suite moves `axis` between -0.2 and 2 rad at up to 1 rad/s, and slowly by a few hundredths of a rad from its
    position.
    """

    modes: frozenset[SweepMode]
    orders: frozenset[str]  # accepted by `Machine.order`, as far as they apply to this drive
    axis: str
    other: str | None = None  # a second axis; tests that need it are skipped without one
    injects: bool = False  # torque noise
    exclusive: bool = False  # one host at a time
    load_encoder: bool = False  # samples of drive-side sweeps have its position
    position_limits: tuple[float, float]  # of the axis, as in the profile
    velocity_limit: float  # of the axis, as in the profile
    effort: float  # limit of the suite's sweeps; the axis' own limit is 1 to 1.8 times this
    slow_effort: tuple[float, float]  # range of the mean effort of a slow forward motion
    least_effort: float  # below the effort of a slow motion
    drive_rate: float = 250.0  # Hz, samples of drive-side sweeps
    sync_period: float = 0.008  # s, of host-streamed sweeps
    amplitude: float = 0.002  # rad/s, of the sines of the suite's sweeps
    least_sine: float = 0.0  # rad, smallest sine that the drive resolves

    @property
    def both(self) -> tuple[str, ...]:
        """The axis, and the second one if there is one."""
        return (self.axis,) if self.other is None else (self.axis, self.other)

    def rate(self, mode: SweepMode) -> float:
        """Samples per second of a sweep."""
        return 1 / self.sync_period if mode is SweepMode.HOST_STREAMED else self.drive_rate

    async def sweep(self, port: DrivePort, mode: SweepMode, periods: int = 2, **changes: Any) -> SweepCommand:
        """A short sweep from the position of the axis, with a window around it."""
        start = (await port.status())[self.axis].position
        command = SweepCommand(
            joint=self.axis,
            mode=mode,
            offset_velocity=0.0105,
            sines=(SineCommand(2.0, self.amplitude, 0.3), SineCommand(4.0, self.amplitude, 1.1)),
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

    async def long_sweep(self, port: DrivePort, mode: SweepMode, **changes: Any) -> SweepCommand:
        """A sweep of 100 s, slow enough to stay in its window."""
        return await self.sweep(port, mode, 200, offset_velocity=0.0045, **changes)

    async def noise(self, port: DrivePort, periods: int = 4, **changes: Any) -> NoiseCommand:
        """A short noise run from the position of the axis, 2 to 40 Hz."""
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


class MachineUnderTest(Protocol):
    """A running machine, seen independently of its port: its true state, and faults that can be injected."""

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
        """True `position`, rad, `velocity`, rad/s, and `fault`, 0 if there is none, of an axis."""
        ...

    def energised(self) -> list[str]:
        """The axes that are energised now."""
        ...

    def order(self, order: str, **fields: Any) -> Mapping[str, Any]:
        """Injects a fault of `Bench.orders`; docs/how-to/write-a-drive-adapter.md describes each."""
        ...

    def recover(self) -> None:
        """Removes every lasting disturbance; faults stay until they are acknowledged."""


async def consume(
    port: DrivePort, command: SweepCommand | NoiseCommand, each: Callable[[SampleBlock], object] = lambda _: None
) -> None:
    """Run a sweep or noise to its end, calling `each` with every block."""
    run = port.run_noise(command) if isinstance(command, NoiseCommand) else port.run_sweep(command)
    async for block in run:
        each(block)


@asynccontextmanager
async def closing(port: DrivePort) -> AsyncGenerator[DrivePort]:
    """Closes the port in any case: an open port would disturb all following tests."""
    try:
        yield port
    finally:
        await port.close()


async def eventually(condition: Callable[[], bool], within: float = 20.0) -> None:
    """Wait until `condition` is true, at most `within` s."""
    deadline = time.monotonic() + within
    while not condition():
        assert time.monotonic() < deadline, "condition never came true"
        await asyncio.sleep(0.01)


def column(blocks: list[SampleBlock], name: str) -> NDArray[np.float64]:
    """One column of all blocks."""
    return np.concatenate([getattr(block, name) for block in blocks])


Test = TypeVar("Test", bound=Callable[..., object])

_NAME = "contract_needs"


@dataclass(frozen=True, slots=True, kw_only=True)
class needs:
    """Marks a test that needs these sweep modes and orders, a drive with or without torque noise, a bus for one host or
    for several, a load encoder, a second axis.

    `missing`: a test over the fixture `mode` covers a mode that the bench does not have.
    """

    modes: Set[SweepMode] = frozenset()
    orders: Set[str] = frozenset()
    injects: bool | None = None
    exclusive: bool | None = None
    load_encoder: bool = False
    other: bool = False
    missing: bool = False

    def __call__(self, test: Test) -> Test:
        setattr(test, _NAME, self)
        return test


def lacking(test: object, bench: Bench, mode: SweepMode | None) -> str:
    """What the bench lacks for a test, including `mode` if it is given; "" if nothing."""
    wanted: needs = getattr(test, _NAME, needs())
    if mode is not None and (mode in bench.modes) is wanted.missing:
        return f"it has {'' if wanted.missing else 'no '}sweep mode {mode.value}"
    if absent := sorted(each.value for each in wanted.modes - bench.modes):
        return f"it has no sweep mode {', '.join(absent)}"
    if absent := sorted(wanted.orders - bench.orders):
        return f"it takes no order {', '.join(absent)}"
    if wanted.injects not in (None, bench.injects):
        return f"it makes {'' if bench.injects else 'no '}torque noise"
    if wanted.exclusive not in (None, bench.exclusive):
        return f"it takes {'one host' if bench.exclusive else 'several hosts'} at a time"
    if wanted.load_encoder and not bench.load_encoder:
        return "it has no load encoder"
    return "it has no second axis" if wanted.other and bench.other is None else ""


class Suite:
    """A test with the fixture `mode` runs once for every sweep mode."""

    @pytest.fixture(params=list(SweepMode), ids=lambda mode: mode.value)
    def mode(self, request: pytest.FixtureRequest) -> SweepMode:
        return request.param

    @pytest.fixture(autouse=True)
    def fitting(self, request: pytest.FixtureRequest, virtual: MachineUnderTest) -> None:
        """Skips tests of functions that the bench lacks."""
        mode = request.getfixturevalue("mode") if "mode" in request.fixturenames else None
        if reason := lacking(request.function, virtual.bench, mode):
            pytest.skip(reason)

    @pytest.fixture
    def axis(self, virtual: MachineUnderTest) -> str:
        return virtual.bench.axis

    @pytest.fixture
    def other(self, virtual: MachineUnderTest, fitting: None) -> str:
        assert virtual.bench.other is not None
        return virtual.bench.other

    @pytest.fixture
    async def port(self, virtual: MachineUnderTest, fitting: None) -> AsyncGenerator[DrivePort]:
        """Connected, with every fault acknowledged. Afterwards closed, and the disturbances are removed."""
        async for connected in connected_port(virtual):
            yield connected


async def connected_port(virtual: MachineUnderTest) -> AsyncGenerator[DrivePort]:
    """Implementation of the fixture `port`."""
    connected = virtual.open()
    await connected.connect()
    for joint in connected.joints:
        await connected.acknowledge(joint)
    yield connected
    virtual.recover()
    await connected.close()
    assert virtual.energised() == []
    left = {thread.name for thread in threading.enumerate() if thread.name.startswith("can-")}
    assert not left
    assert len(asyncio.all_tasks()) == 1
