"""`GET /metrics`."""

import asyncio
from collections.abc import Iterator

import structlog
from fastapi import APIRouter, Response
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import Metric
from prometheus_client.registry import Collector
from sqlalchemy.exc import SQLAlchemyError

from service.store.database import refusal
from service.web.api.dependencies import ApplicationOf
from service.web.api.metrics.machine import machine
from service.web.api.metrics.plant import plant
from service.web.api.metrics.quality import quality
from service.web.api.metrics.work import queues, stored
from service.web.application import Application

router = APIRouter(tags=["health"])

_log = structlog.get_logger(__name__)


class ApplicationCollector(Collector):
    """One scrape of an application. If the database fails, only its own metrics are missing."""

    def __init__(self, application: Application) -> None:
        self._application = application

    def collect(self) -> Iterator[Metric]:
        yield from machine(self._application)
        yield from queues(self._application)
        try:
            yield from stored(self._application)
            yield from plant(self._application)
            yield from quality(self._application.qualities())
        except SQLAlchemyError as error:
            _log.warning("metrics_without_database", reason=refusal(error))


@router.get("/metrics", response_class=Response, responses={200: {"content": {"text/plain": {}}}})
async def get_metrics(application: ApplicationOf) -> Response:
    """Prometheus text format. Each scrape has its own registry: no state is global in the process."""
    if application.cell is not None:
        await application.machine.ask()
    return await asyncio.to_thread(_scrape, application)


def _scrape(application: Application) -> Response:
    registry = CollectorRegistry(auto_describe=False)
    registry.register(ApplicationCollector(application))
    return Response(generate_latest(registry), media_type=CONTENT_TYPE_LATEST)
