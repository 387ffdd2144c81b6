"""Errors that can occur between the service and a drive.

Each class is documented by the situation in which a user meets it. Messages name device, value, limit and unit. Each
has a code, which tells why a machine stopped in any language: see `Cause`.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar, NamedTuple


class CauseCode(StrEnum):
    """Why a motion, a sweep or a campaign ended. Each has a sentence and a next step in `service/web/hmi/texts`."""

    DRIVE_FAULT = "drive_fault"
    EMERGENCY_STOP = "emergency_stop"
    COMMUNICATION_LOST = "communication_lost"
    CONNECTION_FAILED = "connection_failed"
    WRONG_IDENTITY = "wrong_identity"
    WRONG_CONFIGURATION = "wrong_configuration"
    LIMIT_EXCEEDED = "limit_exceeded"  # by a command: nothing moved
    ENVELOPE_LEFT = "envelope_left"
    PATH_NOT_FREE = "path_not_free"
    TARGET_NOT_REACHED = "target_not_reached"
    NOT_READY = "not_ready"
    MOTION_FORBIDDEN = "motion_forbidden"
    HOST_GAP = "host_gap"
    OTHER_HOST = "other_host"
    ENERGY_CHANGED = "energy_changed"  # of an axis, not by this service
    STOP_NOT_CONFIRMED = "stop_not_confirmed"
    SWEEP_REJECTED = "sweep_rejected"
    SWEEP_INTERRUPTED = "sweep_interrupted"
    CHECK_MOVE_FAILED = "check_move_failed"
    SAMPLES_MISSING = "samples_missing"
    IMPLAUSIBLE_CHANNELS = "implausible_channels"
    NOT_IDENTIFIED = "not_identified"
    STOPPED = "stopped"
    SIGN_OF_LIFE = "sign_of_life"
    PAUSED = "paused"
    ABORTED = "aborted"
    SERVICE_ENDED = "service_ended"
    LEASE_NOT_RENEWED = "lease_not_renewed"
    LEASE_LOST = "lease_lost"
    NOT_STORED = "not_stored"
    REFUSED = "refused"
    SWEEPS_SKIPPED = "sweeps_skipped"  # they are not needed, or not possible
    INTERNAL = "internal"


@dataclass(frozen=True, slots=True)
class Cause:
    """Why a motion, a sweep or a campaign ended, for a program and for a page in any language.

    `joint`: "" for the whole machine. `value`, `limit`: in `unit`, SI on the joint side; "hex": the code of a fault.
    `by`: who stopped the machine. `detail`: the sentence of the log, or the words of the person who stopped it.
    """

    code: CauseCode
    joint: str = ""
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    by: str = ""
    detail: str = ""

    def __str__(self) -> str:
        return f"stopped by {self.by}: {self.detail}" if self.by else self.detail


class Measured(NamedTuple):
    """What exceeded which limit, in `unit`; a value that is not finite is None in the cause."""

    value: float
    limit: float | None
    unit: str


class CausedError(Exception):
    """An error that can end a motion. Each class states its code; it raises TypeError if it does not."""

    code: ClassVar[CauseCode]

    def __init_subclass__(cls, *, code: CauseCode) -> None:
        cls.code = code

    def __init__(
        self, *told: str, joint: str = "", measured: Measured | None = None, code: CauseCode | None = None
    ) -> None:
        """`told`: what happened, with the axis before it if it is of one, as in "joint_1" or "joint_1 (node 1)".

        `joint`: if `told` does not begin with it. `code`: if it is another one than that of the class.
        """
        super().__init__(": ".join(told))
        place = told[0].partition(" (")[0] if len(told) > 1 and ", " not in told[0] else ""
        value, limit, unit = measured or (None, None, "")
        finite = value is not None and math.isfinite(value)
        self.cause = Cause(
            code or self.code,
            joint or place,
            value if finite else None,
            limit,
            unit,
            detail=f"{type(self).__name__}: {self}",
        )


class DriveError(CausedError, code=CauseCode.INTERNAL):
    """Base class of all drive errors. The caller must treat the axis as unsafe until its status is known again."""


class BadProfile(DriveError, code=CauseCode.WRONG_CONFIGURATION):
    """A drive profile cannot be used: a misspelt key, a missing value, a missing EDS file."""


class ConnectionFailed(DriveError, code=CauseCode.CONNECTION_FAILED):
    """The bus could not be opened, or a node did not answer: disconnected cable, wrong port, drive without power."""


class WrongIdentity(DriveError, code=CauseCode.WRONG_IDENTITY):
    """The node answers, but it is not the drive of the profile: swapped node ids, other firmware or another gear."""


class WrongConfiguration(DriveError, code=CauseCode.WRONG_CONFIGURATION):
    """The value read back from the drive differs from the value written, or a required object is missing."""


class LimitExceeded(DriveError, code=CauseCode.LIMIT_EXCEEDED):
    """A command is outside the limits of the axis. Raised before any motion."""


class EnvelopeLeft(DriveError, code=CauseCode.ENVELOPE_LEFT):
    """A moving axis exceeded its position window, speed, effort or time limit. It was stopped and disabled."""


class TargetNotReached(DriveError, code=CauseCode.TARGET_NOT_REACHED):
    """An axis was not at rest at the target of its move in time: it is blocked, or too slow for its profile."""


class NotReady(DriveError, code=CauseCode.NOT_READY):
    """The state of the drive does not allow the command, e.g. a sweep on an axis that is not enabled."""


class MotionForbidden(DriveError, code=CauseCode.MOTION_FORBIDDEN):
    """This host was suspended, or another host commands its drives: motion is blocked until a person has checked."""


class DriveFault(DriveError, code=CauseCode.DRIVE_FAULT):
    """The drive reported a fault (EMCY, statusword). It stays de-energised until a person acknowledges the fault."""


class EmergencyStop(DriveFault, code=CauseCode.EMERGENCY_STOP):
    """Safe torque off or the emergency stop was activated."""


class CommunicationLost(DriveError, code=CauseCode.COMMUNICATION_LOST):
    """Samples, heartbeat or the bus were lost while the axis was in use (bus-off, silent node)."""


class StopNotConfirmed(CommunicationLost, code=CauseCode.STOP_NOT_CONFIRMED):
    """An axis did not confirm standstill without energy: silent drive, lost bus, never connected. It may still move."""

    def __init__(self, confirmed: Sequence[str], unconfirmed: Mapping[str, str]) -> None:
        """`confirmed`: joints that confirmed standstill; `unconfirmed`: by joint, why there is no confirmation."""
        alone = next(iter(unconfirmed)) if len(unconfirmed) == 1 else ""
        super().__init__("; ".join(f"{joint}: {reason}" for joint, reason in unconfirmed.items()), joint=alone)
        self.confirmed = tuple(confirmed)
        self.unconfirmed = dict(unconfirmed)


class SweepRejected(DriveError, code=CauseCode.SWEEP_REJECTED):
    """The measuring function of the drive rejected the sweep parameters. Nothing moved."""


class SweepInterrupted(DriveError, code=CauseCode.SWEEP_INTERRUPTED):
    """A sweep, a move or enabling was stopped before its end. All samples up to then were delivered."""


def distinct(value: float, *limits: float, digits: int = 5) -> tuple[str, ...]:
    """A value and its limits for a message: `digits` significant digits, and more where it takes them to tell `value`
    from a limit that it differs from.
    """
    shown = tuple(f"{each:.{digits}g}" for each in (value, *limits))
    same = any(text == shown[0] and limit != value for text, limit in zip(shown[1:], limits, strict=True))
    return distinct(value, *limits, digits=digits + 1) if same and digits < 17 else shown
