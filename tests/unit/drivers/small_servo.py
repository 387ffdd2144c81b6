"""A small CiA 402 servo without a wire, and a machine of some of them: for what the machine does around its drives."""

import asyncio
import threading
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from drivers.cia402 import states
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.connection import DriveThread, P, RunningSweep, T, capabilities
from drivers.cia402.device import Abilities, Feedback, MeasuringState
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import Cia402Machine
from drivers.cia402.states import Controlword, PowerState, Statusword
from drivers.errors import CommunicationLost
from drivers.ports import AxisIdentity, Capabilities, SampleBlock
from tests.unit.drivers.given import axis

HOST_TIMEOUT = 60.0  # s
PATIENCE = 20.0  # s
SHOWN = {
    PowerState.SWITCH_ON_DISABLED: 0x40,
    PowerState.READY: 0x21,
    PowerState.SWITCHED_ON: 0x23,
    PowerState.OPERATION_ENABLED: 0x27,
}
STEPS: dict[int, PowerState] = {
    Controlword.SHUTDOWN: PowerState.READY,
    Controlword.SWITCH_ON: PowerState.SWITCHED_ON,
    Controlword.ENABLE_OPERATION: PowerState.OPERATION_ENABLED,
}


@dataclass
class Servo:
    """`before` is asked at every exchange with its name and may raise or wait; `told` is every controlword."""

    joint: str
    state: PowerState = PowerState.SWITCH_ON_DISABLED
    velocity: float = 0.0
    before: Callable[[str], None] = lambda _: None
    told: list[int] = field(default_factory=list)
    announced: int | None = None  # error that it tells by itself
    unheard: int = 0  # times it was told to stop by what needs no answer
    acknowledges: bool = True  # set-points, by bit 12
    ignored: int | None = None  # controlword that changes nothing
    recorded: int = 0  # samples of the measuring function
    samples_a_look: int = 0
    emergency_stop_codes: tuple[int, ...] = ()
    page_size: int = 64
    injector: None = None

    def __post_init__(self) -> None:
        self.profile = axis(joint=self.joint)
        self.place = f"{self.joint} (small)"
        self.measuring = MeasuringState.IDLE

    @property
    def energised(self) -> bool:
        return self.state in states.ENERGISED

    def identify(self) -> AxisIdentity:
        return AxisIdentity(self.joint, "small", 1, 2, 3, 4, "")

    def configure(self) -> Abilities:
        has: dict[str, Any] = {name: name == "measures" for name in Abilities.__dataclass_fields__}
        return Abilities(**has)

    def _nothing(self, *_: Any, **__: Any) -> None: ...

    allow_motion = forbid_motion = set_mode = check_alive = look_for_restart = forget_error = reopen = _nothing
    read_back = settle_limits = hold_target = set_target = prepare_measuring = _nothing

    def statusword(self) -> int:
        self.before("statusword")
        acknowledged = self.acknowledges and bool(self.told) and self.told[-1] & Controlword.NEW_SET_POINT
        return SHOWN[self.state] | (Statusword.SET_POINT_ACKNOWLEDGED if acknowledged else 0)

    def control(self, controlword: int) -> None:
        self.before(f"control {controlword:02X}")
        self.told.append(controlword)
        if controlword == self.ignored:
            return
        self.state = STEPS.get(controlword & 0x0F, PowerState.SWITCH_ON_DISABLED)
        if not self.energised:
            self.velocity = 0.0
            self.measuring = MeasuringState.ABORTED if self.measuring is MeasuringState.RUNNING else self.measuring

    def announced_error(self) -> int | None:
        return self.announced

    def error_code(self) -> int:
        return 0

    def error_text(self, code: int) -> str:
        return f"error {code:04X}h"

    def stop_unheard(self) -> None:
        self.unheard += 1
        self.state = PowerState.SWITCH_ON_DISABLED

    def motion(self) -> Feedback:
        self.before("motion")
        return Feedback(0.0, self.velocity, 0.0)

    def start_measuring(self) -> None:
        self.measuring = MeasuringState.RUNNING

    def abort_measuring(self) -> None:
        self.measuring = MeasuringState.ABORTED

    def measuring_state(self) -> MeasuringState:
        return self.measuring

    def rejection(self) -> str:
        return ""

    def samples_recorded(self) -> int:
        self.recorded += self.samples_a_look
        return self.recorded

    def page(self, first: int, count: int) -> SampleBlock:
        index = np.arange(first, first + count)
        zero = np.zeros(count)
        return SampleBlock(self.joint, index, index / 250.0, zero, zero, zero, zero)


class AskedThread(DriveThread):
    """Counts how often it was asked for."""

    asked = 0

    async def run(self, function: Callable[P, T], *args: P.args, **kwargs: P.kwargs) -> T:
        self.asked += 1
        return await super().run(function, *args, **kwargs)


class Link:
    """A connection, and the fieldbus that opens it."""

    sync_period = 0.004

    def __init__(self, servos: Sequence[Servo]) -> None:
        self._servos = servos
        self.watch = HostWatch(HOST_TIMEOUT)
        self.opened = self.closed = self.halted = 0

    async def open(self) -> "Link":
        self.opened += 1
        self.thread = AskedThread("small")
        self.axes = {servo.joint: Cia402Axis(servo, self.watch) for servo in self._servos}
        self.identities = tuple([await self.thread.run(axis.introduce) for axis in self.axes.values()])
        return self

    @property
    def capabilities(self) -> Capabilities:
        return capabilities(self.axes.values())

    async def stream(self, sweeps: object, stop: threading.Event) -> RunningSweep:
        raise CommunicationLost("no streams here")

    def halt(self, *, streaming: bool) -> None:
        self.halted += 1

    async def close(self) -> None:
        self.closed += 1
        await self.thread.close()


def machine(*servos: Servo) -> tuple[Cia402Machine, Link]:
    """Not connected yet."""
    link = Link(servos)
    return Cia402Machine([servo.profile for servo in servos], link), link  # pyright: ignore[reportArgumentType]


@asynccontextmanager
async def connected(*servos: Servo) -> AsyncGenerator[tuple[Cia402Machine, Link]]:
    port, link = machine(*servos)
    await port.connect()
    yield port, link
    await port.close()


class Gate:
    """Holds a servo's exchange of a name, from `shut` on, until it is opened. Blocking, on the machine's thread."""

    def __init__(self, exchange: str) -> None:
        self._exchange = exchange
        self._open, self._reached = threading.Event(), threading.Event()
        self._shut = False

    def shut(self) -> None:
        self._shut = True

    def open(self) -> None:
        self._open.set()

    async def reached(self) -> None:
        assert await asyncio.to_thread(self._reached.wait, PATIENCE)

    def __call__(self, exchange: str) -> None:
        if self._shut and exchange == self._exchange:
            self._reached.set()
            assert self._open.wait(PATIENCE)
