"""Planted faults: small changes of the product, made in a copy of this process, that the exploration must find."""

import asyncio
from collections.abc import Callable
from typing import Any

from drivers.cia402.axis import Axis
from drivers.cia402.machine import Cia402Machine
from service.execution.machine import Machine
from service.execution.motion import Motion

Plant = Callable[[], None]


def _set(owner: Any, name: str, value: Any) -> Plant:
    def plant() -> None:
        assert hasattr(owner, name), f"{owner} has no {name}: the fault is out of date"
        setattr(owner, name, value)

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


async def _only_first(self: Any, link: Any, axes: Any) -> None:
    await _REAL_BRING_DOWN(self, link, [*axes][1:])


DRIVES: dict[str, Plant] = {
    "halt does nothing": _set(Cia402Machine, "halt", _nothing),
    "the stop waits": _set(Cia402Machine, "stop", _stop_that_waits),
    "the stop does nothing": _set(Cia402Machine, "stop", _nothing_async),
    "the stop sequence leaves out the first axis": _set(Cia402Machine, "_bring_down", _only_first),
    "the stop sequence disables nothing": _set(Cia402Machine, "_bring_down", _nothing_async),
    "an axis is not disabled": _set(Axis, "disable", _nothing),
}
"""Found by a stop at any moment."""

SERVICE: dict[str, Plant] = {
    "the gate forgets lease and latch": _set(Motion, "_may_move", _nothing),
    "the machine never refuses": _set(Machine, "check_may_move", _nothing),
}
"""Found by random sequences."""
