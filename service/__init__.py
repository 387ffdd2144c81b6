"""The errors of the service: invalid input of a user, and internal errors."""

from collections.abc import Generator
from contextlib import contextmanager

from drivers.errors import CauseCode, CausedError


class SweepidError(Exception):
    """Base of all errors that the service raises intentionally."""


class BadInput(SweepidError):
    """External input cannot be used; no part of it was stored.

    `place` names the file, sweep or field, `reason` the value and the limit: ``f"{place}: {reason}"``.
    The CLI prints that line and exits with 2; the API answers 422 with `place` as the pointer.
    """

    def __init__(self, place: str, reason: str) -> None:
        super().__init__(f"{place}: {reason}")
        self.place = place
        self.reason = reason


@contextmanager
def writing(place: object) -> Generator[None]:
    """BadInput for a file or folder, asked for by a user, that cannot be written."""
    try:
        yield
    except OSError as error:
        # a folder that is to be made where a file is
        reason = "Not a directory" if isinstance(error, FileExistsError) else error.strerror or error
        raise BadInput(str(place), f"cannot be written: {reason}") from None


class NotFound(SweepidError):
    """A requested resource does not exist (API: 404)."""


class Conflict(SweepidError):
    """The command is not possible in the present state, e.g. starting a campaign that runs (API: 409)."""


class Superseded(Conflict):
    """A stop, a gap of the host, trouble with the lease or a restart came after the command was given (API: 409)."""


class NotNow(SweepidError):
    """Nothing was done, because a required part does not answer now; the request may be repeated later (API: 503)."""


class MotionFailed(SweepidError, CausedError, code=CauseCode.INTERNAL):
    """Base of the errors with which the service itself ends a motion or a sweep."""


class EnvelopeViolation(MotionFailed, code=CauseCode.ENVELOPE_LEFT):
    """A motion would leave the safety envelope; nothing moved, or the machine was stopped."""


class NoPdf(SweepidError):
    """The libraries for PDF are not installed."""


class ServiceUnreachable(SweepidError):
    """No service answers at the address: it is not started, or the address is wrong."""


class ServiceProblem(SweepidError):
    """The service rejected the request or failed; `status` and `detail` are those of its problem document."""

    def __init__(self, status: int, detail: str) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
