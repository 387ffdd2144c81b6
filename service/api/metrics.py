"""Figures for Prometheus, read from the application when they are asked for."""

from collections.abc import Iterator

from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from service.api.dependencies import ApplicationOf
from service.application import Application

router = APIRouter(tags=["health"])


class LabCollector(Collector):
    """One scrape of a application."""

    def __init__(self, application: Application) -> None:
        self._application = application

    def collect(self) -> Iterator[Metric]:
        machine, running = self._application.machine, self._application.runner.running
        yield GaugeMetricFamily("sweepid_machine_connected", "1 while the drives answer", machine.connected)
        yield GaugeMetricFamily("sweepid_stop_latched", "1 while a stop holds the machine", machine.latched is not None)
        yield GaugeMetricFamily("sweepid_campaign_running", "1 while a campaign owns the machine", running is not None)
        yield CounterMetricFamily("sweepid_events", "events of the outbox", self._application.store.last_event_id())
        sweeps = GaugeMetricFamily("sweepid_sweeps", "sweeps of the running campaign", labels=("state",))
        if running is not None:
            for state, count in self._application.store.campaign(running).sweeps.items():
                sweeps.add_metric((state.value,), count)
        yield sweeps


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
def get_metrics(application: ApplicationOf) -> Response:
    """Prometheus text format. Each scrape has its own registry: nothing of the process is global."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(LabCollector(application))
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
