"""What can go wrong between the service and a drive.

Every class is documented by the scenario in which a user meets it; messages name device, value, limit and unit.
"""

from collections.abc import Mapping, Sequence


class DriveError(Exception):
    """Any trouble with a drive. The caller must take the axis to be unsafe until it is told otherwise."""


class BadProfile(DriveError):
    """A drive profile cannot be used: a misspelt key, a missing value, an EDS file that is not there."""


class ConnectionFailed(DriveError):
    """The bus could not be opened, or a node did not answer: cable off, wrong port, drive without power."""


class WrongIdentity(DriveError):
    """The node answers, but it is not the drive of the profile: swapped node ids, another firmware or gear."""


class WrongConfiguration(DriveError):
    """A value written to the drive was not what the drive gave back, or a needed object is absent."""


class LimitExceeded(DriveError):
    """A command lies outside the axis' limits. Raised before anything moves."""


class EnvelopeLeft(DriveError):
    """A moving axis left its position window, speed, effort or time limit. It was stopped and disabled."""


class NotReady(DriveError):
    """The drive's state does not allow the command, e.g. a sweep on an axis that is not enabled."""


class MotionForbidden(DriveError):
    """This host was suspended, or is not alone with its drives: nothing moves until a person has looked."""


class DriveFault(DriveError):
    """The drive reported a fault (EMCY, statusword). It stays de-energised until a person acknowledges."""


class EmergencyStop(DriveFault):
    """Safe torque off or emergency stop was pressed."""


class CommunicationLost(DriveError):
    """Samples, heartbeat or the bus itself went away while the axis was in use (bus-off, silent node)."""


class StopNotConfirmed(CommunicationLost):
    """An axis did not say that it stands and has no energy: drive silent, bus gone, never connected. It may move."""

    def __init__(self, confirmed: Sequence[str], unconfirmed: Mapping[str, str]) -> None:
        """`confirmed`: the joints that stand; `unconfirmed`: by joint, why that is not known."""
        super().__init__("; ".join(f"{joint}: {reason}" for joint, reason in unconfirmed.items()))
        self.confirmed = tuple(confirmed)
        self.unconfirmed = dict(unconfirmed)


class SweepRejected(DriveError):
    """The drive's measuring function refused the sweep parameters. Nothing moved."""


class SweepInterrupted(DriveError):
    """A sweep, a move or enabling ended early because somebody stopped it. The samples so far were delivered."""
