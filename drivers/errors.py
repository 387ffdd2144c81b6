"""Errors that can occur between the service and a drive.

Each class is documented by the situation in which a user meets it. Messages name device, value, limit and unit.
"""

from collections.abc import Mapping, Sequence


class DriveError(Exception):
    """Base class of all drive errors. The caller must treat the axis as unsafe until its status is known again."""


class BadProfile(DriveError):
    """A drive profile cannot be used: a misspelt key, a missing value, a missing EDS file."""


class ConnectionFailed(DriveError):
    """The bus could not be opened, or a node did not answer: disconnected cable, wrong port, drive without power."""


class WrongIdentity(DriveError):
    """The node answers, but it is not the drive of the profile: swapped node ids, other firmware or another gear."""


class WrongConfiguration(DriveError):
    """The value read back from the drive differs from the value written, or a required object is missing."""


class LimitExceeded(DriveError):
    """A command is outside the limits of the axis. Raised before any motion."""


class EnvelopeLeft(DriveError):
    """A moving axis exceeded its position window, speed, effort or time limit. It was stopped and disabled."""


class TargetNotReached(DriveError):
    """An axis was not at rest at the target of its move in time: it is blocked, or too slow for its profile."""


class NotReady(DriveError):
    """The state of the drive does not allow the command, e.g. a sweep on an axis that is not enabled."""


class MotionForbidden(DriveError):
    """This host was suspended, or another host commands its drives: motion is blocked until a person has checked."""


class DriveFault(DriveError):
    """The drive reported a fault (EMCY, statusword). It stays de-energised until a person acknowledges the fault."""


class EmergencyStop(DriveFault):
    """Safe torque off or the emergency stop was activated."""


class CommunicationLost(DriveError):
    """Samples, heartbeat or the bus were lost while the axis was in use (bus-off, silent node)."""


class StopNotConfirmed(CommunicationLost):
    """An axis did not confirm standstill without energy: silent drive, lost bus, never connected. It may still move."""

    def __init__(self, confirmed: Sequence[str], unconfirmed: Mapping[str, str]) -> None:
        """`confirmed`: joints that confirmed standstill; `unconfirmed`: by joint, why there is no confirmation."""
        super().__init__("; ".join(f"{joint}: {reason}" for joint, reason in unconfirmed.items()))
        self.confirmed = tuple(confirmed)
        self.unconfirmed = dict(unconfirmed)


class SweepRejected(DriveError):
    """The measuring function of the drive rejected the sweep parameters. Nothing moved."""


class SweepInterrupted(DriveError):
    """A sweep, a move or enabling was stopped before its end. All samples up to then were delivered."""


_EVERY_DIGIT = 17  # significant digits that tell any two floating-point numbers apart


def distinct(value: float, *limits: float, digits: int = 5) -> tuple[str, ...]:
    """A value and its limits for a message: `digits` significant digits, and more where it takes them to tell `value`
    from a limit that it differs from.
    """
    shown = tuple(f"{each:.{digits}g}" for each in (value, *limits))
    same = any(text == shown[0] and limit != value for text, limit in zip(shown[1:], limits, strict=True))
    return distinct(value, *limits, digits=digits + 1) if same and digits < _EVERY_DIGIT else shown
