"""Metrics of recordings and pending computations, and of the free space of database and disk."""

from collections.abc import Iterator
from datetime import UTC, datetime
from time import perf_counter

from prometheus_client.core import Metric

from service.process.telemetry import TRACING
from service.web.api.metrics.figure import Figure, figures_of
from service.web.application import Application

WAITING = Figure("sweepid_jobs_open", "jobs that wait or are under way, by kind", ("machine", "kind"))
VIEWERS = Figure("sweepid_live_viewers", "subscribers of live samples")
DROPPED = Figure("sweepid_live_blocks_dropped", "blocks of live samples that a viewer was too slow for", counter=True)
DISK = Figure("sweepid_disk_free_bytes", "free in the data folder")
DATABASE = Figure("sweepid_database_read_seconds", "time of the smallest read of the database; without it, it refused")
EVENTS = Figure("sweepid_events", "events of the outbox", counter=True)
SWEEPS = Figure("sweepid_sweeps", "sweeps of the running campaign", ("machine", "state"))
RECORDINGS = Figure("sweepid_recordings", "recordings that are stored", ("state",))
SAMPLES = Figure("sweepid_recorded_samples", "samples in them", ("state",))

BLOCKS = Figure("sweepid_recorder_blocks_waiting", "blocks of samples that the disk has not taken yet")
WORKER = Figure("sweepid_worker_available", "1 while jobs can be executed")
PUBLISHED = Figure("sweepid_published_dropped", "events that were not published by MQTT", counter=True)
PUBLISHING = Figure("sweepid_publishing_trouble", "1 while OPC UA server or MQTT client does not work", ("part",))
SPANS = Figure("sweepid_spans_dropped", "spans of traces that were not sent", counter=True)
HERE_ALONE = Figure("sweepid_recordings_waiting", "recordings that the object store does not have yet")
OLDEST = Figure("sweepid_recordings_waiting_seconds", "age of the oldest of them")
REFUSED = Figure("sweepid_recordings_refused", "1 while they cannot be moved")

NEIGHBOURS = (PUBLISHED, PUBLISHING, SPANS)  # absent if nothing is published
MOVED = (HERE_ALONE, OLDEST, REFUSED)  # absent if the recordings stay in the data folder
FIGURES = figures_of(globals())


def queues(application: Application) -> Iterator[Metric]:
    """Metrics from the process itself and from the disk."""
    cell = application.cell
    if cell is not None:
        kinds = {"identification": cell.jobs.open, "diagnosis": cell.diagnosing.open, "data check": cell.checking.open}
        kinds["re-identification"] = cell.batches.open
        yield WAITING.by({(application.settings.machine_name, kind): count for kind, count in kinds.items()})
    yield VIEWERS.of(application.hub.viewers)
    yield DROPPED.of(application.hub.dropped)
    yield WORKER.of(not application.worker.trouble)
    if cell is not None:
        yield BLOCKS.of(cell.executor.blocks_waiting)
    if cell is not None and cell.publisher is not None:
        publisher = cell.publisher
        yield PUBLISHED.of(publisher.dropped)
        yield PUBLISHING.by({(part,): bool(publisher.troubles.get(part)) for part in publisher.parts})
    if (dropped := TRACING.dropped) is not None:
        yield SPANS.of(dropped)
    free = application.files.free_disk()
    if free is not None:
        yield DISK.of(free)


def stored(application: Application) -> Iterator[Metric]:
    """Metrics from the database. SQLAlchemyError if the database fails."""
    store, cell = application.store, application.cell
    running = None if cell is None else cell.runner.running
    began = perf_counter()
    events = store.last_event_id()
    yield DATABASE.of(perf_counter() - began)
    yield EVENTS.of(events)
    sweeps = {} if running is None else store.campaign(running).sweeps
    yield SWEEPS.by({(application.settings.machine_name, state.value): count for state, count in sweeps.items()})
    recorded = store.recorded()
    yield RECORDINGS.by({(state.value,): of.recordings for state, of in recorded.items()})
    yield SAMPLES.by({(state.value,): of.samples for state, of in recorded.items()})
    if cell is not None and cell.moving is not None:
        backlog = cell.moving.backlog()
        yield HERE_ALONE.of(backlog.waiting)
        yield OLDEST.of(0.0 if backlog.since is None else (datetime.now(UTC) - backlog.since).total_seconds())
        yield REFUSED.of(bool(backlog.trouble))
