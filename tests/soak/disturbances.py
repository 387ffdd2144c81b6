"""What goes wrong on a shop floor, and what people do, each to be done at any moment of a campaign and undone.

The eleven faults of a machine hall (bus-off, lost or doubled PDO, drive fault, suspended host, full disk, power cut,
two clients, wrong axis or pose, emergency stop, identity of another drive, killed worker), data that
cannot be written, and commands that cross one another.
"""

import os
import random
import signal
import sqlite3
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Protocol

import psutil

from service.web.client import ServiceClient, ServiceProblem
from tests.faults import ADAPTERS, AXIS, FAULTS, Adapter, Order
from tests.soak import data_faults
from tests.system.rest_bench import PATIENCE, Service, VirtualMachine


class Bench(Protocol):
    """What disturbances may lay hands on."""

    machine: VirtualMachine
    service: Service
    client: ServiceClient
    plan: int
    campaign: int
    chance: random.Random

    def client_anew(self) -> None: ...

    def started(self, campaign: int) -> None: ...


Act = Callable[[Bench], None]


@dataclass(frozen=True)
class Disturbance:
    """`ends`: whatever happens, nothing may move afterwards until a person acts; else the service decides.

    `keeps`: the disk keeps what it said it had kept, so that of what was measured only the last moment may be lost.
    """

    name: str
    make: Act
    undo: tuple[Act, ...] = ()
    ends: bool = True
    keeps: bool = True
    adapters: tuple[Adapter, ...] = ADAPTERS


def _order(order: Order) -> Act:
    def act(bench: Bench) -> None:
        reply = bench.machine.order(order[0], **order[1])
        assert reply["ok"], reply

    return act


def _fault(name: str, *, ends: bool) -> Disturbance:
    """Of the table; one that nothing takes back comes to an axis that has energy, if one has."""
    fault = FAULTS[name]
    order, fields = fault.make

    def make(bench: Bench) -> None:
        if not fault.undo and fields.get("joint") == AXIS:
            moving = next((joint for joint, axis in bench.machine.axes().items() if axis["energised"]), AXIS)
            _order((order, fields | {"joint": moving}))(bench)
        else:
            _order(fault.make)(bench)

    return Disturbance(name, make, tuple(map(_order, fault.undo)), ends, adapters=fault.adapters)


def _in_a_power_cut(fault: str) -> Act:
    """Power fails; when it returns the drives are not those that were there."""

    def act(bench: Bench) -> None:
        bench.machine.power_off()
        bench.machine.power_on()
        _order(FAULTS[fault].make)(bench)
        with suppress(ServiceProblem):
            bench.client.connect()
            raise AssertionError(f"{fault}: the drives were connected")

    return act


def _power_cut(bench: Bench) -> None:
    bench.machine.power_off()
    time.sleep(bench.chance.uniform(0.0, 1.0))


def _restart(bench: Bench) -> None:
    bench.service.start()
    bench.client_anew()


def _ended_kindly(bench: Bench) -> None:
    signals = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # under nohup the service does not end by it either
        signals.append(signal.SIGHUP)
    bench.service.running().send_signal(bench.chance.choice(signals))
    assert bench.service.end() == 0, bench.service.log()[-2000:]


def _suspended(bench: Bench) -> None:
    """For less than the drives wait for their host, or for longer."""
    process = psutil.Process(bench.service.running().pid)
    process.suspend()
    time.sleep(bench.chance.choice([bench.chance.uniform(0.05, 1.0), bench.chance.uniform(4.0, 6.0)]))
    process.resume()


def _worker_killed(bench: Bench) -> None:
    for worker in bench.service.workers():
        with suppress(psutil.NoSuchProcess):
            worker.kill()


def _full_disk(bench: Bench) -> None:
    """No file of the service grows beyond some length: each write there fails, at whatever place it happens to be."""
    length = bench.chance.choice([0, 4096, 100_000, 1_000_000])
    for process in _family(bench):
        with suppress(psutil.NoSuchProcess):
            process.rlimit(psutil.RLIMIT_FSIZE, (length, psutil.RLIM_INFINITY))
    time.sleep(bench.chance.uniform(0.2, 5.0))


def _room_again(bench: Bench) -> None:
    for process in _family(bench):
        with suppress(psutil.NoSuchProcess):
            process.rlimit(psutil.RLIMIT_FSIZE, (psutil.RLIM_INFINITY, psutil.RLIM_INFINITY))


def _family(bench: Bench) -> list[psutil.Process]:
    service = psutil.Process(bench.service.running().pid)
    return [service, *service.children(recursive=True)]


def _locked(bench: Bench) -> None:
    """Another program holds the database."""
    (file,) = bench.service.data.glob("sweepid.sqlite")
    with closing(sqlite3.connect(file, timeout=PATIENCE, isolation_level=None)) as other:
        other.execute("BEGIN IMMEDIATE")
        time.sleep(bench.chance.choice([bench.chance.uniform(0.1, 2.0), bench.chance.uniform(8.0, 12.0)]))
        other.execute("ROLLBACK")


def _stopped(bench: Bench) -> None:
    """503 tells that a drive did not confirm; the stop holds all the same."""
    with suppress(ServiceProblem):
        bench.client.stop("Ada", "soak")


def _paused(bench: Bench) -> None:
    with suppress(ServiceProblem):  # it is over already
        bench.client.pause(bench.campaign)


def _crossing(bench: Bench) -> None:
    """Four clients at once want something else each."""

    def wanting(what: int) -> None:
        with ServiceClient(bench.service.url) as client, suppress(ServiceProblem):
            if what == 0:
                another = int(client.add_campaign(bench.plan)["id"])
                client.start(another)
                bench.started(another)
            elif what == 1:
                client.resume(bench.campaign, repeat=True)
            elif what == 2:
                client.connect()
            else:
                client.acknowledge(AXIS)

    with ThreadPoolExecutor(4) as clients:
        list(clients.map(wanting, range(4)))


def _stop_process_killed(bench: Bench) -> None:
    for process in psutil.Process(bench.service.running().pid).children():
        with suppress(psutil.NoSuchProcess):
            if "service.machine.stop_process" in process.cmdline():
                os.kill(process.pid, signal.SIGKILL)


DISTURBANCES = (
    *(_fault(name, ends=True) for name in ("drive fault", "fault of an axis that stands", "emergency stop", "bus-off")),
    *(
        _fault(name, ends=False)
        for name in (
            "limit switch",
            "large encoder glitch",
            "silent node",
            "reboot of the node",
            "lost PDO",
            "duplicated PDOs",
        )
    ),
    Disturbance("power cut of the drives", _power_cut, (lambda bench: bench.machine.power_on(),)),
    Disturbance(
        "another drive after a power cut",
        _in_a_power_cut("wrong identity"),
        tuple(map(_order, FAULTS["wrong identity"].undo)),
    ),
    Disturbance(
        "drives swapped in a power cut",
        _in_a_power_cut("swapped addresses"),
        tuple(map(_order, FAULTS["swapped addresses"].undo)),
    ),
    Disturbance("service killed", lambda bench: bench.service.kill(), (_restart,)),
    Disturbance("service told to end", _ended_kindly, (_restart,)),
    Disturbance("service suspended", _suspended, ends=False),
    Disturbance("workers killed", _worker_killed, ends=False),
    Disturbance("stop process killed", _stop_process_killed, ends=False),
    Disturbance("disk full", _full_disk, (_room_again,), ends=False),
    Disturbance("database locked", _locked, ends=False),
    Disturbance("stream torn by a power cut", data_faults.torn_stream, (_restart,), keeps=False),
    Disturbance("commits lost in a power cut", data_faults.lost_commits, (_restart,), keeps=False),
    Disturbance("damaged recording", data_faults.damaged_recording, ends=False),
    Disturbance("read-only folder", data_faults.locked_folder, ends=False),
    Disturbance("STOP", _stopped),
    Disturbance("pause", _paused, ends=False),  # what moves comes to its end first
    Disturbance("clients that cross one another", _crossing, ends=False),
)
