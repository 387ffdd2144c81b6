"""A signal that ends `sweepid measure` is not lost where Python drops its exception."""

import signal

import pytest

from service.cli.commands.campaigns import TerminationSignals


class Finalized:
    """Python drops what is raised in its finalizer."""

    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_signal_while_a_finalizer_runs_is_raised_again() -> None:
    with TerminationSignals() as signals:
        signals.check()
        Finalized()
        assert signals.by == "SIGTERM"
        with pytest.raises(KeyboardInterrupt):
            signals.check()
