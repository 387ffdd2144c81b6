"""The published data. SI units; JSON between the service and its publisher, and to MQTT."""

from datetime import datetime
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, JsonValue

from service.planning.campaigns.stored_results import AxisEstimateQuality
from service.process.settings import Mqtt, OpcUa, Settings
from service.store.documents import CampaignState


class _Published(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class Held(_Published):
    """A stop that was not released yet; negative `id`: it is not in the database yet."""

    id: int
    by: str
    why: str
    at: datetime


class MachineState(_Published):
    """`state`: `moves`, `unknown`, `energised` or `stands` (`service.machine.execution.statement`).

    `reason`: why it may not move, or does not answer; else empty.
    """

    name: str
    connected: bool
    may_move: bool
    state: Literal["moves", "unknown", "energised", "stands"]
    stopped: bool
    stops: tuple[Held, ...]
    reason: str


class CampaignProgress(_Published):
    """The campaign last started, changed or measured on this machine. `sweeps`, `axes`: running now."""

    id: int
    state: CampaignState
    cause: str
    done: int
    total: int
    sweeps: tuple[int, ...]
    axes: tuple[str, ...]


class LinkParameters(_Published):
    """The ten parameters of a link at the origin of its frame: kg, kg m, kg m^2, by name (`m`, `mx` ... `Izz`)."""

    parameters: dict[str, float]


class LatestEstimate(_Published):
    """The latest estimate of a campaign of this machine; `links` with its bodies."""

    robot: str
    campaign: int
    revision: int
    made: datetime
    condition: float | None
    axes: dict[str, AxisEstimateQuality]
    links: dict[str, LinkParameters]


class PublishedState(_Published):
    """The complete state; null for missing parts."""

    machine: MachineState
    campaign: CampaignProgress | None
    estimate: LatestEstimate | None


class Notice(_Published):
    """An event. `number`: of the event in the database, null for a stop or a release."""

    number: int | None
    kind: str
    campaign: int | None
    at: datetime
    data: JsonValue


class Configuration(_Published):
    """The configuration of the publisher."""

    machine: str
    opcua: OpcUa | None
    mqtt: Mqtt | None
    log_level: str

    @classmethod
    def of(cls, settings: Settings) -> Self | None:
        """None if nothing is published. BadInput if files in the settings are invalid."""
        opcua, mqtt = settings.opcua, settings.mqtt
        if opcua is None and mqtt is None:
            return None
        return cls(
            machine=settings.machine_name,
            opcua=None if opcua is None else opcua.checked(),
            mqtt=None if mqtt is None else mqtt.checked(trusted_network=settings.trusted_network),
            log_level=settings.log_level,
        )


class ToPublisher(_Published):
    """One line to the publisher: the configuration first, then states and notices."""

    configuration: Configuration | None = None
    state: PublishedState | None = None
    notice: Notice | None = None


class FromPublisher(_Published):
    """One line from the publisher: `part` works (at `port`) or has trouble. Since the start of the process:
    numbers of published and of dropped notices.
    """

    part: Literal["opcua", "mqtt"]
    port: int | None = None
    trouble: str = ""
    dropped: int = 0
    published: int = 0
