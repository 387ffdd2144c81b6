"""Plays the person at the machine: starts a campaign, watches it, looks after faults, and stops when told to."""

from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass

from service.client import Json, ServiceClient, ServiceProblem
from service.errors import SweepidError

_PATIENCE = 3  # faults that the person acknowledges before giving up


class CampaignFailed(SweepidError):
    """The campaign did not come to its end; the message says why."""


@dataclass(frozen=True)
class Operator:
    """`progress` is told of the campaign at each event, `say` what a person would note in the log."""

    client: ServiceClient
    progress: Callable[[Json], None]
    say: Callable[[str], None]

    def run(self, campaign_id: int) -> None:
        """Run a campaign until its last sweep is identified. Whatever else ends this stops the machine first."""
        with self._stopping():
            self.client.start(campaign_id)
            self._until_completed(campaign_id)

    def watch(self, campaign_id: int) -> None:
        """The same with a campaign that has been started."""
        with self._stopping():
            self._until_completed(campaign_id)

    @contextmanager
    def _stopping(self) -> Generator[None]:
        try:
            yield
        except BaseException as error:
            try:
                self.client.stop("sweepid demo", type(error).__name__)
            except SweepidError as unconfirmed:  # it must not hide what ended the campaign
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
                self.say(f"{campaign['cause']} - looked, acknowledged, sweep repeated")
                self._clear(campaign_id)

    def _clear(self, campaign_id: int) -> None:
        """What a person does after a fault: look, acknowledge, go on with the sweep that failed.

        Going on connects first where the connection was lost; a fault found then is one more trouble.
        """
        for axis in self.client.drives()["axes"]:
            if axis["fault"] is not None:
                self.client.acknowledge(axis["joint"])
        try:
            self.client.resume(campaign_id, repeat=True)
        except ServiceProblem as problem:
            raise CampaignFailed(f"campaign {campaign_id} cannot go on: {problem}") from None
