"""Simulates the operator: starts a campaign, monitors it, acknowledges faults, and stops on request."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass

from service.model.errors import SweepidError
from service.web.client import HOST_WATCH, Json, ServiceClient, ServiceProblem

_PATIENCE = 3  # faults that the operator acknowledges before giving up


class CampaignFailed(SweepidError):
    """The campaign was not completed; the message gives the reason."""


@dataclass(frozen=True)
class Operator:
    """`progress` is called with the campaign at each event, `say` with notes for the log."""

    client: ServiceClient
    progress: Callable[[Json], None]
    say: Callable[[str], None]

    def run(self, campaign_id: int) -> None:
        """Run a campaign until its last sweep is identified. Any other end stops the machine first."""
        with self._stopping():
            self.client.start(campaign_id)
            self._until_completed(campaign_id)

    def watch(self, campaign_id: int) -> None:
        """The same for a campaign that was already started."""
        with self._stopping():
            self._until_completed(campaign_id)

    @contextmanager
    def _stopping(self) -> Generator[None]:
        try:
            yield
        except BaseException as error:
            try:
                self.client.stop("sweepid demo", type(error).__name__)
            except SweepidError as unconfirmed:  # must not hide the error that ended the campaign
                self.say(str(unconfirmed))
            raise

    def _until_completed(self, campaign_id: int) -> None:
        troubles = 0
        for _ in self.client.events(campaign_id):
            campaign = self.client.campaign(campaign_id)
            self.progress(campaign)
            if campaign["state"] == "completed":
                return
            if campaign["state"] == "aborted":
                raise CampaignFailed(f"campaign {campaign_id} was aborted: {campaign['cause']}")
            if campaign["state"] == "paused":
                troubles += 1
                if troubles > _PATIENCE:
                    raise CampaignFailed(
                        f"campaign {campaign_id} paused for the {troubles}th time: {campaign['cause']}"
                    )
                self.say(f"{campaign['cause']} - checked, acknowledged, sweep repeated")
                self._clear(campaign_id)

    def _clear(self, campaign_id: int) -> None:
        """React to a fault as an operator: check, acknowledge, continue with the failed sweep.

        Continuing reconnects first if the connection was lost; a fault found then is another fault. A stop of the host
        watch (this computer was suspended) is released; a stop that a person pressed is not.
        """
        watched = [stop["id"] for stop in self.client.stops() if stop["by"] == HOST_WATCH]
        if watched:
            self.client.reset_stop("sweepid demo", watched)
        for axis in self.client.drives()["axes"]:
            if axis["fault"] is not None:
                self.client.acknowledge(axis["joint"])
        try:
            self.client.resume(campaign_id, repeat=True)
        except ServiceProblem as problem:
            raise CampaignFailed(f"campaign {campaign_id} cannot go on: {problem}") from None
