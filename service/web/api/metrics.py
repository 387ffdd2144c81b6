"""`GET /metrics` for Prometheus: every metric, and where its values come from at each scrape.

``python -m service.web.api.metrics > docs/reference/metrics.md`` writes the reference page.

Whether the process runs, and whether it can measure now.
"""

import asyncio
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from time import perf_counter

import structlog
from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector
from pydantic import BaseModel
from sqlalchemy.exc import SQLAlchemyError

from service.machine.execution.statement import Condition
from service.planning.campaigns.stored_results import Quality
from service.process.telemetry import TRACING
from service.store.access import Role
from service.store.database import refusal
from service.web.api.dependencies import ApplicationOf
from service.web.api.route_roles import allow
from service.web.application import Application

health_routes = APIRouter(prefix="/health", tags=["health"])


class Live(BaseModel):
    """The process answers."""

    alive: bool


class WaitingRecordings(BaseModel):
    """Recordings that the object store does not have yet: number, time of the oldest, and the error of the store."""

    waiting: int
    since: datetime | None
    trouble: str


class Ready(BaseModel):
    """`causes`: why measuring or identification is impossible now, one line per cause.

    A service without a machine is ready while it can show the plant.
    `recordings`: null if they stay in the data folder. An unreachable store is no cause: measuring continues.
    """

    ready: bool
    causes: tuple[str, ...]
    recordings: WaitingRecordings | None


@health_routes.head("/live", include_in_schema=False)  # monitors ask so
@health_routes.get("/live")
@allow(None)
async def get_live() -> Live:
    return Live(alive=True)


@health_routes.head("/ready", include_in_schema=False)
@health_routes.get("/ready", responses={503: {"model": Ready, "description": "not ready to measure"}})
@allow(None)
async def get_ready(response: Response, application: ApplicationOf) -> Ready:
    causes = await application.troubles()
    response.status_code = 503 if causes else 200
    return Ready(ready=not causes, causes=causes, recordings=await _recordings(application))


async def _recordings(application: Application) -> WaitingRecordings | None:
    moving = None if application.cell is None else application.cell.moving
    if moving is None:
        return None
    found = await asyncio.to_thread(moving.backlog)
    return WaitingRecordings.model_validate(found, from_attributes=True)


metric_routes = APIRouter(tags=["health"])

_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class MetricDefinition:
    """Name of a metric, with its unit by the naming rules of Prometheus, its description, and its labels.

    `absent`: not in each installation. `counter`: grows only, while the process runs; Prometheus adds "_total" to its
    name.
    """

    name: str
    help: str
    labels: tuple[str, ...] = ()
    counter: bool = False
    absent: bool = False

    @property
    def shown(self) -> str:
        """The name of its samples, with labels."""
        name = f"{self.name}_total" if self.counter else self.name
        return f"{name}{{{', '.join(self.labels)}}}" if self.labels else name


def _gauge(name: str, text: str, *labels: str, absent: bool = False) -> MetricDefinition:
    return MetricDefinition(f"sweepid_{name}", text, labels, absent=absent)


def _counter(name: str, text: str, *labels: str, absent: bool = False) -> MetricDefinition:
    return MetricDefinition(f"sweepid_{name}", text, labels, counter=True, absent=absent)


GROUPS: dict[str, tuple[MetricDefinition, ...]] = {
    "Machine and bus": (
        _gauge("machine_connected", "1 while the drives answer", "machine"),
        _gauge("machine_may_move", "1 while nothing forbids a campaign to move the machine", "machine"),
        _gauge("machine_state", "1 for the state that the drives report", "machine", "state"),
        _gauge("stop_latched", "1 while a stop holds the machine", "machine"),
        _gauge("stops_held", "stops that a person has not released yet", "machine"),
        _gauge("campaign_running", "1 while a campaign owns the machine", "machine"),
        _gauge("set_points", "set-points of the last sweep that the host streamed", "machine"),
        _gauge("set_points_missed", "those of them that could not be sent within their cycle", "machine"),
        _gauge("set_point_lateness_seconds", "how late they were, as median and at worst", "machine", "which"),
        _counter("set_points_sent", "set-points that the host streamed in recorded sweeps", "machine"),
        _counter("bus_cycles_missed", "those that could not be sent within their cycle", "machine"),
        _counter(
            "bus_frames", "CAN frames since the bus was opened, by direction", "machine", "direction", absent=True
        ),
        _counter(
            "bus_bytes",
            "size of these frames, without stuff bits; its rate over the rate of the bus is the load of the bus",
            "machine",
            absent=True,
        ),
        _gauge(
            "bus_bytes_per_second",
            "what the bus can carry, where the drive profile sets its bit rate",
            "machine",
            absent=True,
        ),
    ),
    "Recorder, queue, disk and database": (
        _gauge("jobs_open", "jobs that wait or are under way, by kind", "machine", "kind"),
        _gauge("live_viewers", "subscribers of live samples"),
        _counter("live_blocks_dropped", "blocks of live samples that a viewer was too slow for"),
        _gauge("disk_free_bytes", "free in the data folder"),
        _gauge("database_read_seconds", "time of the smallest read of the database; without it, it refused"),
        _counter("events", "events of the outbox"),
        _gauge("sweeps", "sweeps of the running campaign", "machine", "state"),
        _gauge("recordings", "recordings that are stored", "state"),
        _gauge("recorded_samples", "samples in them", "state"),
        _gauge("recorder_blocks_waiting", "blocks of samples that the disk has not taken yet"),
        _gauge("worker_available", "1 while jobs can be executed"),
        _counter("published_dropped", "events that were not published by MQTT", absent=True),
        _gauge("publishing_trouble", "1 while OPC UA server or MQTT client does not work", "part", absent=True),
        _counter("spans_dropped", "spans of traces that were not sent", absent=True),
        _gauge("recordings_waiting", "recordings that the object store does not have yet", absent=True),
        _gauge("recordings_waiting_seconds", "age of the oldest of them", absent=True),
        _gauge("recordings_refused", "1 while they cannot be moved", absent=True),
    ),
    "Machines of the plant": (
        _gauge("campaigns", "campaigns of the machine, by state", "machine", "state"),
        _gauge("machine_stops_held", "stops that hold the machine, as they are stored", "machine"),
    ),
    "Identification": (
        _gauge("estimate_revision", "of the robot's latest estimate", "robot"),
        _gauge("estimate_time_seconds", "when it was made, Unix time; time() less this is its age", "robot"),
        _gauge("estimate_condition_number", "of its linear system", "robot"),
        _gauge("estimate_suspect_sweeps", "sweeps that do not fit the others", "robot"),
        _gauge("estimate_sweeps", "sweeps of the axis in it", "robot", "axis"),
        _gauge(
            "estimate_gap_ratio",
            "RMS difference of measured inertia and that of the robot file, relative",
            "robot",
            "axis",
        ),
        _gauge(
            "estimate_left_ratio",
            "RMS difference of measured inertia and that of the estimate, relative",
            "robot",
            "axis",
        ),
        _gauge(
            "estimate_std_ratio", "median relative uncertainty of the inertia over the workspace, 1 s", "robot", "axis"
        ),
    ),
}
"""All metrics, as the reference page groups them."""
_DEFINITIONS = {one.name: one for group in GROUPS.values() for one in group}


def _one(name: str, value: float) -> Metric:
    """One value without labels."""
    return _each(name, {(): value})


def _each(name: str, values: Mapping[tuple[str, ...], float]) -> Metric:
    """One value for each set of labels, in the order of the definition."""
    of = _DEFINITIONS[f"sweepid_{name}"]
    family = (CounterMetricFamily if of.counter else GaugeMetricFamily)(of.name, of.help, labels=of.labels)
    for labels, value in values.items():
        family.add_metric(labels, value)
    return family


@metric_routes.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
@allow(Role.VIEWER)
async def get_metrics(application: ApplicationOf) -> Response:
    """Prometheus text format. Each scrape has its own registry: no state is global in the process."""
    if application.cell is not None:
        await application.machine.ask()
    return await asyncio.to_thread(_scrape, application)


def _scrape(application: Application) -> Response:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_ApplicationCollector(application))
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)


class _ApplicationCollector(Collector):
    """One scrape of an application. If the database fails, only its own metrics are missing."""

    def __init__(self, application: Application) -> None:
        self._application = application

    def collect(self) -> Iterator[Metric]:
        yield from _machine(self._application)
        yield from _queues(self._application)
        try:
            yield from _stored(self._application)
            yield from _plant(self._application)
            yield from _quality(self._application.qualities())
        except SQLAlchemyError as error:
            _log.warning("metrics_without_database", reason=refusal(error))


def _machine(application: Application) -> Iterator[Metric]:
    """Metrics from the process only, not from the database; the drives were asked before. Empty without a machine."""
    if application.cell is None:
        return
    machine, name = application.machine, (application.settings.machine_name,)
    answers, state = machine.answers, machine.statement.state
    yield _each("machine_connected", {name: answers})
    yield _each("machine_may_move", {name: answers and not machine.forbidden})
    yield _each("machine_state", {(*name, each.value): each is state for each in Condition})
    yield _each("stop_latched", {name: machine.latched is not None})
    yield _each("stops_held", {name: len(machine.stops)})
    yield _each("campaign_running", {name: application.runner.running is not None})
    executor = application.own.executor
    yield _each("set_points_sent", {name: executor.set_points})
    yield _each("bus_cycles_missed", {name: executor.set_points_missed})
    traffic = machine.bus_traffic
    if traffic is not None:
        yield _each("bus_frames", {(*name, "received"): traffic.received, (*name, "sent"): traffic.sent})
        yield _each("bus_bytes", {name: traffic.bits / 8})
        if traffic.bitrate is not None:
            yield _each("bus_bytes_per_second", {name: traffic.bitrate / 8})
    timing = machine.set_point_timing
    if timing is not None:
        yield _each("set_points", {name: timing.cycles})
        yield _each("set_points_missed", {name: timing.missed})
        yield _each(
            "set_point_lateness_seconds",
            {(*name, "median"): timing.median_lateness, (*name, "worst"): timing.worst_lateness},
        )


def _queues(application: Application) -> Iterator[Metric]:
    """Metrics from the process itself and from the disk."""
    cell = application.cell
    if cell is not None:
        kinds = {"identification": cell.jobs.open, "diagnosis": cell.diagnosing.open, "data check": cell.checking.open}
        kinds["re-identification"] = cell.batches.open
        yield _each("jobs_open", {(application.settings.machine_name, kind): count for kind, count in kinds.items()})
    yield _one("live_viewers", application.hub.viewers)
    yield _one("live_blocks_dropped", application.hub.dropped)
    yield _one("worker_available", not application.worker.trouble)
    if cell is not None:
        yield _one("recorder_blocks_waiting", cell.executor.blocks_waiting)
    if cell is not None and cell.publisher is not None:
        publisher = cell.publisher
        yield _one("published_dropped", publisher.dropped)
        yield _each("publishing_trouble", {(part,): bool(publisher.troubles.get(part)) for part in publisher.parts})
    if (dropped := TRACING.dropped) is not None:
        yield _one("spans_dropped", dropped)
    free = application.files.free_disk()
    if free is not None:
        yield _one("disk_free_bytes", free)


def _stored(application: Application) -> Iterator[Metric]:
    """Metrics from the database. SQLAlchemyError if the database fails."""
    store, cell = application.store, application.cell
    running = None if cell is None else cell.runner.running
    began = perf_counter()
    events = store.last_event_id()
    yield _one("database_read_seconds", perf_counter() - began)
    yield _one("events", events)
    sweeps = {} if running is None else store.campaign(running).sweeps
    yield _each("sweeps", {(application.settings.machine_name, state.value): count for state, count in sweeps.items()})
    recorded = store.recorded()
    yield _each("recordings", {(state.value,): of.recordings for state, of in recorded.items()})
    yield _each("recorded_samples", {(state.value,): of.samples for state, of in recorded.items()})
    if cell is not None and cell.moving is not None:
        backlog = cell.moving.backlog()
        yield _one("recordings_waiting", backlog.waiting)
        yield _one(
            "recordings_waiting_seconds",
            0.0 if backlog.since is None else (datetime.now(UTC) - backlog.since).total_seconds(),
        )
        yield _one("recordings_refused", bool(backlog.trouble))


def _plant(application: Application) -> Iterator[Metric]:
    """SQLAlchemyError if the database fails."""
    counts = application.plant.campaigns().items()
    yield _each("campaigns", {(name, state.value): count for (name, state), count in counts})
    yield _each("machine_stops_held", {(name,): count for name, count in application.plant.stops_held().items()})


def _quality(latest: Mapping[str, Quality]) -> Iterator[Metric]:
    """The metrics of all robots that have an estimate."""
    robots = {(name,): one for name, one in latest.items()}
    yield _each("estimate_revision", {robot: one.revision for robot, one in robots.items()})
    yield _each("estimate_time_seconds", {robot: one.made for robot, one in robots.items()})
    yield _each(
        "estimate_condition_number",
        {robot: one.condition for robot, one in robots.items() if one.condition is not None},
    )
    yield _each("estimate_suspect_sweeps", {robot: one.suspect for robot, one in robots.items()})
    axes = {(name, joint): axis for name, one in latest.items() for joint, axis in one.axes.items()}
    yield _each("estimate_sweeps", {axis: one.sweeps for axis, one in axes.items()})
    yield _each("estimate_gap_ratio", {axis: one.gap for axis, one in axes.items()})
    yield _each("estimate_left_ratio", {axis: one.left for axis, one in axes.items()})
    yield _each("estimate_std_ratio", {axis: one.std for axis, one in axes.items() if one.std is not None})


def page() -> str:
    """The reference page, as Markdown."""
    lines = [
        "# Metrics",
        "",
        "Generated from the table in `service/web/api/metrics.py`. `GET /metrics` returns them for Prometheus.",
        "With the setting `login: true` a key with the scope `metrics` is enough: [Permissions](permissions.md).",
        "`machine` is the name of a machine. A service without one (`--no-machine`) gives no figure of its own.",
        "A value that is not known is omitted; it is never reported as 0.",
    ]
    for group, definitions in GROUPS.items():
        lines += ["", f"## {group}", "", "| metric | kind | meaning |", "|---|---|---|"]
        for one in definitions:
            lines.append(f"| `{one.shown}` | {'counter' if one.counter else 'gauge'} | {one.help} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.stdout.write(page())
