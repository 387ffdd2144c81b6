"""Axes get energy only while no other axis of the machine has it, also if another host enables one at the same time."""

import logging
import threading
from collections.abc import Collection

from drivers.cia402 import states
from drivers.cia402.axis import Axis, Energy
from drivers.errors import DriveError, NotReady

logger = logging.getLogger(__name__)


def enable_alone(axes: Collection[Axis], all_axes: Collection[Axis], stop: threading.Event) -> None:
    """Enables `axes`; if one cannot be enabled, all of them are left disabled. Blocking.

    The others are checked before and after: of two hosts that enable different axes at once, each energises its own
    before it looks at the other's, so at least one sees the other's and takes its own back before it moves.
    """
    _require_alone(axes, all_axes)
    try:
        for axis in axes:
            axis.enable(stop)
        _require_alone(axes, all_axes)
    except BaseException:
        for axis in (each for each in axes if each.energy is not Energy.OFF):  # the others may be another host's
            try:
                axis.disable()
            except DriveError as error:  # the others must be disabled all the same
                logger.error("after enabling failed: %s", error)
        raise


def _require_alone(axes: Collection[Axis], all_axes: Collection[Axis]) -> None:
    """Raises NotReady if another axis has energy."""
    for other in all_axes:
        state = other.state()
        other.check(state)
        if other not in axes and state in states.ENERGISED:
            place = next(iter(axes)).place
            raise NotReady(place, f"{other.place} is '{state.value}'; it must be disabled first")
