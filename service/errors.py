"""What the service tells a person who gave it something it cannot use, and what it raises inside."""


class SweepidError(Exception):
    """Base of all errors that the service raises on purpose."""


class BadInput(SweepidError):
    """Something given from outside cannot be used; nothing of it was stored.

    `place` names the file, sweep or field, `reason` the value and the limit: ``f"{place}: {reason}"``.
    The CLI prints that line and exits with 2; the API answers 422 with `place` as the pointer.
    """

    def __init__(self, place: str, reason: str) -> None:
        super().__init__(f"{place}: {reason}")
        self.place = place
        self.reason = reason


class NotFound(SweepidError):
    """A resource that was asked for by name does not exist (API: 404)."""


class Conflict(SweepidError):
    """The command does not fit the present state, e.g. starting a campaign that runs (API: 409)."""


class NotNow(SweepidError):
    """Nothing was done, because what it needs does not answer now; the same may be sent again later (API: 503)."""


class EnvelopeViolation(SweepidError):
    """A motion would leave the safety envelope; nothing moved, or the machine was stopped."""
