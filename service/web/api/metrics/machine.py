"""Metrics of the machine: its state, the causes that hold it, and the timing of its bus."""

from collections.abc import Iterator

from prometheus_client.core import Metric

from service.machine.execution.statement import Condition
from service.web.api.metrics.figure import Figure, figures_of
from service.web.application import Application

_MACHINE = ("machine",)

CONNECTED = Figure("sweepid_machine_connected", "1 while the drives answer", _MACHINE)
MAY_MOVE = Figure("sweepid_machine_may_move", "1 while nothing forbids a campaign to move the machine", _MACHINE)
STATE = Figure("sweepid_machine_state", "1 for the state that the drives report", (*_MACHINE, "state"))
LATCHED = Figure("sweepid_stop_latched", "1 while a stop holds the machine", _MACHINE)
STOPS = Figure("sweepid_stops_held", "stops that a person has not released yet", _MACHINE)
RUNNING = Figure("sweepid_campaign_running", "1 while a campaign owns the machine", _MACHINE)
SET_POINTS = Figure("sweepid_set_points", "set-points of the last sweep that the host streamed", _MACHINE)
MISSED = Figure("sweepid_set_points_missed", "those of them that could not be sent within their cycle", _MACHINE)
LATENESS = Figure(
    "sweepid_set_point_lateness_seconds", "how late they were, as median and at worst", ("machine", "which")
)

STREAMED = Figure(
    "sweepid_set_points_sent", "set-points that the host streamed in recorded sweeps", _MACHINE, counter=True
)
CYCLES_MISSED = Figure(
    "sweepid_bus_cycles_missed", "those that could not be sent within their cycle", _MACHINE, counter=True
)
FRAMES = Figure(
    "sweepid_bus_frames",
    "CAN frames since the bus was opened, by direction",
    (*_MACHINE, "direction"),
    counter=True,
)
ON_THE_WIRE = Figure(
    "sweepid_bus_bytes",
    "size of these frames, without stuff bits; its rate over the rate of the bus is the load of the bus",
    _MACHINE,
    counter=True,
)
RATE = Figure(
    "sweepid_bus_bytes_per_second", "what the bus can carry, where the drive profile sets its bit rate", _MACHINE
)

TRAFFIC = (FRAMES, ON_THE_WIRE, RATE)  # only while a CAN bus is open
FIGURES = figures_of(globals())


def machine(application: Application) -> Iterator[Metric]:
    """Metrics from the process only, not from the database; the drives were asked before. Empty without a machine."""
    if application.cell is None:
        return
    machine, name = application.machine, (application.settings.machine_name,)
    answers, state = machine.answers, machine.statement.state
    yield CONNECTED.by({name: answers})
    yield MAY_MOVE.by({name: answers and not machine.forbidden})
    yield STATE.by({(*name, each.value): each is state for each in Condition})
    yield LATCHED.by({name: machine.latched is not None})
    yield STOPS.by({name: len(machine.stops)})
    yield RUNNING.by({name: application.runner.running is not None})
    executor = application.own.executor
    yield STREAMED.by({name: executor.set_points})
    yield CYCLES_MISSED.by({name: executor.set_points_missed})
    traffic = machine.bus_traffic
    if traffic is not None:
        yield FRAMES.by({(*name, "received"): traffic.received, (*name, "sent"): traffic.sent})
        yield ON_THE_WIRE.by({name: traffic.bits / 8})
        if traffic.bitrate is not None:
            yield RATE.by({name: traffic.bitrate / 8})
    timing = machine.set_point_timing
    if timing is not None:
        yield SET_POINTS.by({name: timing.cycles})
        yield MISSED.by({name: timing.missed})
        yield LATENESS.by({(*name, "median"): timing.median_lateness, (*name, "worst"): timing.worst_lateness})
