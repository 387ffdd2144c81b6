"""Planted faults: small changes of the product, made in a copy of this process, that the exploration must find.

Each has what of a sequence it is searched with: the whole distribution finds it as well, later. Not in the list,
because nothing that anybody could observe changes:

- one of the checks of the epoch removed while another follows before the energy (before the drives are connected; in
  the transaction of a start; before or after enabling): a later one refuses. All of one kind together are in the list.
- `HostWatch.check` alone: `halt` and the beat of the event loop find the same gap.
- `Cia402Axis._check_wanted` alone: the stop sequence, next on the same thread, takes the energy away within 0.5 s.
- the latch in the database alone, without a restart: the one in memory holds.
- `StopBus.stop` alone: the confirmation sends the stop again.
- the stop of the service alone while the stop process sends it, and the reverse while the service runs: each hides the
  other; "no stop is sent" takes both away.
"""

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from drivers.canopen.stop_sender import CanopenStopSender
from drivers.cia402.axis import Cia402Axis
from drivers.cia402.host_watch import HostWatch
from drivers.cia402.machine import Cia402Machine
from service.machine.execution import stops
from service.machine.execution.energising import Approvals, Epochs, Intention
from service.machine.execution.machine import Machine
from service.machine.execution.motion import MotionAccess
from service.machine.execution.runner import Runner
from service.machine.execution.statement import Reports
from service.machine.execution.stops import LatchedStops, StopSequences
from service.machine.stop_process.bus import StopBus, StopOutcome
from service.store import lease_and_latch
from service.store.lease_and_latch import MachineLease
from service.store.store import Store
from tests.virtual_time import sequences as s

Plant = Callable[[], None]


@dataclass(frozen=True)
class Fault:
    """`only`: what happens in the sequences; (): everything. `steps`: how many times."""

    plant: Plant
    only: Sequence[s.Action] = ()
    steps: tuple[int, int] = s.STEPS


def _set(owner: Any, name: str, value: Any) -> Plant:
    def plant() -> None:
        if not hasattr(owner, name):  # no AssertionError, which would count as found
            raise LookupError(f"{owner} has no {name}: the fault is out of date")
        setattr(owner, name, value)

    return plant


def _all(*plants: Plant) -> Plant:
    def plant() -> None:
        for each in plants:
            each()

    return plant


def _nothing(*_: object, **__: object) -> None:
    return None


async def _nothing_async(*_: object, **__: object) -> tuple[str, ...]:
    return ()


async def _stop_that_waits(self: Any) -> tuple[str, ...]:
    await asyncio.sleep(10.0)
    return await _REAL_STOP(self)


_REAL_STOP = Cia402Machine.stop
_REAL_BRING_DOWN = Cia402Machine._bring_down  # pyright: ignore[reportPrivateUsage]
_REAL_CHECK_MACHINE = Runner._check_machine  # pyright: ignore[reportPrivateUsage]
_REAL_END_SWEEP = Store.end_sweep


async def _only_first(self: Any, link: Any, axes: Any) -> None:
    await _REAL_BRING_DOWN(self, link, [*axes][1:])


DRIVES: dict[str, Plant] = {
    "the stop waits": _set(Cia402Machine, "stop", _stop_that_waits),
    "the stop does nothing": _set(Cia402Machine, "stop", _nothing_async),
    "the stop sequence leaves out the first axis": _set(Cia402Machine, "_bring_down", _only_first),
    "the stop sequence disables nothing": _set(Cia402Machine, "_bring_down", _nothing_async),
    "an axis is not disabled": _set(Cia402Axis, "disable", _nothing),
}
"""Found by a stop at any moment on each bus."""
HALT = {"halt does nothing": _set(Cia402Machine, "halt", _nothing)}
"""On CANopen; on Modbus `stop` alone is as fast."""
MOVES = ("the stop sequence leaves out the first axis", "the stop sequence disables nothing")
"""Searched with moves alone: the end of a sweep or of enabling hides them."""


async def _takes_the_present_epoch(self: Any, intention: Intention) -> None:
    await self._machine.reach()
    object.__setattr__(intention, "epoch", self._machine.epochs.now)
    await _REAL_CHECK_MACHINE(self, intention)


def _recorded_twice(self: Any, campaign: int, number: int, move: Any, *more: Any, **named: Any) -> Any:
    ended = _REAL_END_SWEEP(self, campaign, number, move, *more, **named)
    if (recording := named.get("recording")) is not None:
        self.add_recording(campaign, number, ended.attempt + 1, recording)
    return ended


def _lost(self: Any, campaign: int, number: int, move: Any, *more: Any, **named: Any) -> Any:
    return _REAL_END_SWEEP(self, campaign, number, move, *more, **named | {"recording": None})


_HOLD = LatchedStops.latch


def _not_latched(self: Any, *given: Any) -> Any:
    hold = _HOLD(self, *given)
    self._holds.clear()
    return hold


def _silent(self: Any) -> StopOutcome:
    return StopOutcome(dict.fromkeys(self._joints, ""))


async def _confirms_at_once(self: Any) -> tuple[str, ...]:
    return self._port.joints


async def _does_not_end(self: Any, _why: str) -> None:
    await asyncio.sleep(0.0)


RUNS = (s.start, s.put_right)


async def _take_back_unattended(self: Any, campaign: int, intention: Intention, if_version: Any, _: Any) -> Any:
    return await _REAL_TAKE_BACK(self, campaign, intention, if_version, None)


_REAL_TAKE_BACK = Runner._take_back_pause  # pyright: ignore[reportPrivateUsage]
_REAL_RESET = LatchedStops.reset


async def _releases_all(self: Any, by: str, _: Sequence[int]) -> Any:
    return await _REAL_RESET(self, by, [stop.id for stop in self.documents])


ONCE = 1, 1
PENDING = (s.approved_again,)

SERVICE: dict[str, Fault] = {
    "the gate forgets lease, latch and epoch": Fault(
        _set(MotionAccess, "_may_move", _nothing), (s.start, s.stop_by_port, s.abort)
    ),
    "the machine never refuses": Fault(_set(Machine, "check_may_move", _nothing), (s.start, s.stop_by_port)),
    "no epoch is ever checked": Fault(_set(Epochs, "check", _nothing), PENDING, ONCE),
    "a command takes the epoch of its execution": Fault(
        _set(Runner, "_check_machine", _takes_the_present_epoch), PENDING, ONCE
    ),
    "a stop begins no epoch": Fault(_set(Epochs, "begin", _nothing), PENDING, ONCE),
    "stops are not latched": Fault(_set(LatchedStops, "latch", _not_latched), (s.start, s.stop_by_port)),
    "a gap of the host is not noticed": Fault(
        _all(_set(HostWatch, "look", _nothing), _set(HostWatch, "reason", "")), (s.start, s.connect, s.host_gap)
    ),
    "the end of motion is empty": Fault(_set(MotionAccess, "end", _nothing_async), (s.broken_off,), ONCE),
    "an abort does not end what runs": Fault(
        _set(Runner, "_end_task", _does_not_end), (s.start, s.abort, s.acknowledge)
    ),
    "the port confirms what it did not hear": Fault(
        _set(CanopenStopSender, "confirm", lambda self, _: dict.fromkeys(self._joints.values(), "")),
        (s.start, s.stop_by_port),
    ),
    "the API confirms what it did not wait for": Fault(
        _set(StopSequences, "confirmed", _confirms_at_once), (s.start, s.stop_by_api)
    ),
    "a lease that another has counts as renewed": Fault(
        _all(_set(MachineLease, "renew", _nothing)), (s.start, s.second_service)
    ),
    "what gets energy is stated to stand": Fault(_set(Reports, "gets_energy", _nothing), RUNS),
    "plans need no approval": Fault(_set(Approvals, "check", _nothing), (s.start,)),
    "an approval outlives a stop": Fault(
        _set(lease_and_latch, "_last_stop", lambda *_: 0), (s.start, s.stop_by_port, s.release)
    ),
    "the lease is never missed": Fault(_set(stops, "_passed", lambda _: 0.0), (s.start, s.second_service)),
    "the stop process sends nothing": Fault(_set(CanopenStopSender, "_send", _nothing), (s.stop_in_a_gap,), ONCE),
    "a stop is not stored": Fault(_set(LatchedStops, "note", _nothing), (s.stop_outlives_a_kill,), ONCE),
    "a release releases what nobody saw": Fault(_set(LatchedStops, "reset", _releases_all), (s.late_release,), ONCE),
    "an old report counts": Fault(_set(Reports, "stale", float("inf")), (s.start, s.let_run, s.stop_by_port)),
    "a missed sign of life stops nothing": Fault(_set(Runner, "_missed", _nothing), (s.attended,), ONCE),
    "a pause that is taken back asks for no sign of life": Fault(
        _set(Runner, "_take_back_pause", _take_back_unattended), (s.start, s.pause_taken_back)
    ),
    "a sweep is counted twice": Fault(_set(Store, "end_sweep", _recorded_twice), (s.start, s.let_run)),
    "a recording is lost": Fault(_set(Store, "end_sweep", _lost), (s.start, s.let_run)),
    "no stop is sent": Fault(
        _all(
            _set(Cia402Machine, "halt", _nothing),
            _set(Cia402Machine, "stop", _nothing_async),
            _set(StopBus, "stop", _silent),
        ),
        (s.start, s.stop_by_api, s.stop_by_port),
    ),
}
"""Found by random sequences."""
