"""Exclusive control of the units of a line, where their map has the signal `control_owner`.

Modbus does not tell a drive which host writes. Drives with such a register hold the token of one host, refuse that of
another, and drop it if it is not repeated for the time of their watchdog. Every unit is taken before the first axis is
enabled, so that two hosts cannot enable two axes of one machine, and is kept until the connection is closed.
"""

import logging
import secrets
from collections.abc import Sequence
from contextlib import suppress

from drivers.cia402.host_watch import HostWatch
from drivers.errors import CommunicationLost, DriveError, NotReady, WrongConfiguration
from drivers.modbus.registers import RegisterMap
from drivers.modbus.unit import Setting, Unit

logger = logging.getLogger(__name__)

OWNER = "control_owner"
NOBODY = 0


class Control:
    """Blocking, on the thread of the line. Does nothing if the map lacks the signal."""

    def __init__(self, units: Sequence[Unit], registers: RegisterMap, watch: HostWatch) -> None:
        self._signal = registers.signals.get(OWNER)
        self._units = tuple(units) if self._signal is not None else ()
        self._watch = watch
        most = 0 if self._signal is None else self._signal.format.most
        self._token = 1 + secrets.randbelow(max(1, int(most)))
        self._held = False

    def take(self) -> None:
        """Raises NotReady if another host has control of a unit; then none is taken."""
        if self._held or self._signal is None:
            return
        taken: list[Unit] = []
        try:
            for unit in self._units:
                unit.settle(Setting(self._signal, self._token))
                taken.append(unit)
        except WrongConfiguration as error:
            self._give_up(taken)
            raise NotReady(f"another host has control of this machine, or had it until this moment: {error}") from None
        except BaseException:
            self._give_up(taken)
            raise
        self._held = True

    def renew(self) -> None:
        """With every heartbeat. If another host has taken a unit, nothing may move until a person has checked."""
        for unit in self._units if self._held else ():
            try:
                unit.write({OWNER: self._token})
            except CommunicationLost:
                pass  # reported by the heartbeat
            except WrongConfiguration as error:
                self._watch.seen(f"another host has taken control: {error}")

    def release(self) -> None:
        """May be called twice."""
        held, self._held = self._held, False
        self._give_up(self._units if held else ())

    def _give_up(self, units: Sequence[Unit]) -> None:
        for unit in units:
            with suppress(DriveError):  # it lapses
                if unit.integer(OWNER) == self._token:
                    unit.write({OWNER: NOBODY})
