"""Access to motion: the only object that enables or moves an axis.

It exists inside `Machine.motion`, for the present user of the machine, and cannot be used after it. An axis is
energised only after the envelope has accepted the path from the positions of all axes. Lease, latch and epoch are
checked before and after enabling and again before each motion; the axes are disabled after they have moved. If the
block ends by an error, including cancellation, every axis is brought to standstill without energy, here and nowhere
else.
"""

import asyncio
from collections.abc import AsyncGenerator, Callable, Coroutine, Sequence
from contextlib import aclosing, asynccontextmanager
from typing import Protocol

from drivers.errors import Cause, CommunicationLost, DriveError, distinct
from drivers.ports import DrivePort, NoiseCommand, SampleBlock, SweepCommand
from service import Conflict
from service.machine.execution.statement import Reports

Command = SweepCommand | NoiseCommand
Go = Callable[[float], Coroutine[object, object, None]]
"""Moves the axis to a position, rad (m)."""


class Bounds(Protocol):
    """Limits of every motion: the envelope of the robot in its cell. Checks raise EnvelopeViolation."""

    @property
    def joints(self) -> tuple[str, ...]: ...

    def check_move(self, joint: str, pose: Sequence[float], target: float, velocity: float) -> None: ...

    def check_run(self, commands: Sequence[Command], pose: Sequence[float]) -> None: ...


class MotionAccess:
    """See the module docstring. `check` raises Conflict while motion is blocked; `lost` receives why the drives do not
    answer.
    """

    def __init__(
        self,
        port: DrivePort,
        envelope: Bounds,
        check: Callable[[], None],
        lost: Callable[[str, Cause], None],
        reports: Reports,
    ) -> None:
        self._port, self._envelope, self._check, self._lost = port, envelope, check, lost
        self._reports = reports
        self._open = True

    @asynccontextmanager
    async def moving(self, joint: str, here: Sequence[float], target: float, velocity: float) -> AsyncGenerator[Go]:
        """One axis is energised during the block; `go` moves it, to `target` or less far, at `velocity`, rad/s (m/s).

        Raises EnvelopeViolation if the path is not free or not allowed; then nothing was energised.
        """
        await asyncio.to_thread(self._envelope.check_move, joint, here, target, velocity)
        low, high = sorted((here[self._envelope.joints.index(joint)], target))

        async def go(to: float) -> None:
            if not low - 1e-9 <= to <= high + 1e-9:  # rad (m), of rounding
                shown, lowest, highest = distinct(to, low, high, digits=6)
                raise Conflict(f"{joint}: target {shown} is outside the checked range {lowest} to {highest}")
            self._may_move()
            await self._port.move_to(joint, to, velocity)

        async with self._energised(joint):
            yield go

    @asynccontextmanager
    async def sweeping(
        self, commands: Sequence[Command], here: Sequence[float]
    ) -> AsyncGenerator[AsyncGenerator[SampleBlock, None]]:
        """The axes of the commands are energised during the block; they move while the blocks of samples are iterated.

        Raises EnvelopeViolation if they would leave the envelope; then nothing was energised.
        """
        await asyncio.to_thread(self._envelope.check_run, commands, here)
        async with self._energised(*(command.joint for command in commands)):
            self._may_move()
            async with aclosing(self._blocks(commands)) as blocks:
                yield blocks

    async def stop(self) -> None:
        """Run the stop sequence, before any other handling of an error. Raises DriveError."""
        await self._port.stop()

    async def end(self, error: BaseException | None) -> None:
        """End of the block. After an error: standstill without energy; a failure of that is added as a note to the
        error.
        """
        self._open = False
        if error is None:
            return
        trouble = [(str(error), error.cause)] if isinstance(error, CommunicationLost) else []
        try:
            await self._port.stop()
        except DriveError as unconfirmed:
            trouble.append((f"the stop is not confirmed: {unconfirmed}", unconfirmed.cause))
            error.add_note(trouble[-1][0])
        if trouble:
            self._lost("; ".join(told for told, _ in trouble), trouble[0][1])

    def _may_move(self) -> None:
        if not self._open:
            raise Conflict("the permission to move has ended")
        self._check()

    @asynccontextmanager
    async def _energised(self, *joints: str) -> AsyncGenerator[None]:
        """After an error `end` disables the axes, with the stop sequence."""
        self._may_move()
        self._reports.gets_energy(joints)
        await self._port.enable(*joints)
        self._may_move()  # a stop may have come while the drives were being enabled
        yield
        for joint in joints:
            await self._port.disable(joint)
        self._reports.gave_energy_up(joints)

    def _blocks(self, commands: Sequence[Command]) -> AsyncGenerator[SampleBlock, None]:
        (first, *_) = commands
        if isinstance(first, NoiseCommand):
            return self._port.run_noise(first)
        return self._port.run_sweep(*(command for command in commands if isinstance(command, SweepCommand)))
