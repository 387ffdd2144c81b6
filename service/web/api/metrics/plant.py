"""Metrics of all machines of the plant, from the database: equal in each service, also in one without a machine."""

from collections.abc import Iterator

from prometheus_client.core import Metric

from service.web.api.metrics.figure import Figure, figures_of
from service.web.application import Application

CAMPAIGNS = Figure("sweepid_campaigns", "campaigns of the machine, by state", ("machine", "state"))
HELD = Figure("sweepid_machine_stops_held", "stops that hold the machine, as they are stored", ("machine",))

FIGURES = figures_of(globals())


def plant(application: Application) -> Iterator[Metric]:
    """SQLAlchemyError if the database fails."""
    counts = application.plant.campaigns().items()
    yield CAMPAIGNS.by({(name, state.value): count for (name, state), count in counts})
    yield HELD.by({(name,): count for name, count in application.plant.stops_held().items()})
