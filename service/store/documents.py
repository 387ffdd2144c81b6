"""What the store hands out: frozen documents, one a row, ready to be sent as JSON.

The states stand here because rows hold them; which state may follow which is the table in `service.campaigns.session`.
"""

import hashlib
import json
from collections.abc import Mapping
from datetime import datetime
from enum import Enum
from typing import Annotated

from pydantic import BaseModel, ConfigDict, JsonValue

from drivers.ports import SweepMode
from service.recording import SweepSpec
from service.results.described import JsonOf
from service.results.estimate import Estimate
from service.robot import Robot, RobotDescription, build_robot

Json = Mapping[str, JsonValue]

LARGEST_ID = 2**31 - 1  # what the integer column of every database holds


class CampaignState(Enum):
    """Where a campaign stands."""

    PLANNED = "planned"  # nothing has moved yet
    RUNNING = "running"  # owns the machine
    PAUSING = "pausing"  # the present sweep is the last for now
    PAUSED = "paused"  # waits for a person; `cause` says why
    MEASURED = "measured"  # no sweep is left to run; identification may still be at work
    COMPLETED = "completed"  # nothing is left to do
    ABORTED = "aborted"  # a person gave it up


class SweepState(Enum):
    """Where a sweep stands."""

    PLANNED = "planned"
    RUNNING = "running"  # its axis may move
    RECORDED = "recorded"  # complete samples on disk; this row is the durable identification job
    IDENTIFIED = "identified"  # an estimate revision contains it
    FAILED = "failed"  # something went wrong; `cause` says what
    INTERRUPTED = "interrupted"  # somebody stopped it, or the service ended under it
    SKIPPED = "skipped"  # never run: its campaign was aborted, or had enough


class RecordingState(Enum):
    """Whether the samples are all there."""

    COMPLETE = "complete"
    PARTIAL = "partial"


class EventKind(Enum):
    """What an event of the outbox is about."""

    CAMPAIGN = "campaign"  # {"state", "cause", "version"}
    SWEEP = "sweep"  # {"number", "state", "cause", "axis", "attempt"}
    CHECK_MOVE = "check_move"  # {"number", "axis", "way", "unit"}: before it is made
    ESTIMATE = "estimate"  # {"revision", "sweep"}
    STOP = "stop"  # {"latched", "by", "why"}; belongs to no campaign
    DIAGNOSIS = "diagnosis"  # {"diagnosis", "state", "cause", "verdicts", "parent"}; belongs to no campaign
    DATA_CHECK = "data_check"  # {}: the campaign's findings are there


class _Document(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RobotDocument(_Document):
    """A robot as it was given; never changed afterwards (the same content has the same row)."""

    id: int
    name: str
    description: RobotDescription
    urdf_text: str
    created_at: datetime

    def build(self) -> Robot:
        return build_robot(self.description, self.urdf_text, f"robot {self.id}")

    @property
    def sha256(self) -> str:
        return robot_sha256(self.description, self.urdf_text)


class PlanRecord(_Document):
    """A stored plan; `document` is the planner's PlanDocument as JSON."""

    id: int
    robot_id: int
    document: dict[str, JsonValue]
    created_at: datetime


class CampaignDocument(_Document):
    """A campaign; `version` grows with every change of state (ETag), `plan_id` is None for an imported one."""

    id: int
    robot_id: int
    plan_id: int | None
    state: CampaignState
    cause: str
    version: int
    sweeps: dict[SweepState, int]  # how many sweeps are in which state; states with none are left out
    created_at: datetime
    started_at: datetime | None


class SweepDocument(_Document):
    """A sweep of a campaign; once recorded, `spec` holds what was measured (sample rate, window, start)."""

    campaign_id: int
    number: int  # 1, 2, ... in the order of the plan
    spec: SweepSpec
    mode: SweepMode | None  # None: imported
    state: SweepState
    cause: str
    attempt: int  # 0 before the first run, +1 with every run


class RecordingDocument(_Document):
    """A recording file; `path` is relative to the data directory."""

    campaign_id: int
    number: int
    attempt: int
    state: RecordingState
    path: str
    sha256: str
    samples: int


class EstimateDocument(_Document):
    """Estimate revision n of a campaign, made when sweep `number` was identified; `document` as `identify --json`."""

    campaign_id: int
    revision: int
    number: int
    document: Annotated[dict[str, JsonValue], JsonOf(Estimate)]
    created_at: datetime

    @property
    def content(self) -> Estimate:
        """What `document` says; BadInput where it is no estimate."""
        return Estimate.read(self.document, f"estimate {self.revision} of campaign {self.campaign_id}")


class EventDocument(_Document):
    """One entry of the outbox; ids only grow."""

    id: int
    campaign_id: int | None
    kind: EventKind
    data: dict[str, JsonValue]
    at: datetime


class StopDocument(_Document):
    """A stop command; the machine is latched while `reset_at` is None."""

    id: int
    by: str
    why: str
    at: datetime
    reset_by: str | None
    reset_at: datetime | None


class StoredAnswer(_Document):
    """The answer once given to a request with this idempotency key."""

    status: int
    body: str


class NewSweep(_Document):
    """A sweep about to be planned."""

    spec: SweepSpec
    mode: SweepMode | None


class NewRecording(_Document):
    """A recording file just written."""

    state: RecordingState
    path: str
    sha256: str
    samples: int


class SpectrumRecord(_Document):
    """The file of an identified sweep's spectrum; `path` is relative to the data directory."""

    path: str
    sha256: str


def robot_sha256(description: RobotDescription, urdf_text: str) -> str:
    """Of description and URDF: the same content has the same one."""
    content = json.dumps([description.model_dump(mode="json"), urdf_text], sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()
