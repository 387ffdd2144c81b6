"""Machine of durand's nodes: python -m tests.durand_nodes socketcand|FD csv|pv

FD is the number of an open SocketCAN socket. `tests/independent_bench.py` says what it prints when it is ready.
"""

import json
import logging
import selectors
import signal
import socket
import sys
import time
from collections.abc import Callable
from typing import Any

import structlog
from durand import set_scheduler

from simulator.canopen.line import SocketcandServer
from simulator.canopen.pdo import Frame
from tests.durand_nodes.drive import ENERGISED, Drive
from tests.durand_nodes.network import KernelBus, Network, Timers
from tests.durand_nodes.objects import GEAR, PRODUCT, RATED, REVISION, VENDOR
from tests.durand_nodes.plant import STEP, Plant

INERTIAS = {"joint_1": 137.0, "joint_3": 61.0}  # kg m^2
FRICTION = (120.0, 1500.0)  # N m, N m s/rad
EMERGENCY_STOP = 0x9000
TICK = 2e-3  # s
BACKLOG = 2.0  # s that are made up for on a busy computer


class Machine:
    def __init__(self, bus: str, modes: str) -> None:
        self.selector = selectors.SelectSelector()
        self._timers = Timers(time.monotonic())
        set_scheduler(self._timers)
        self.bus: SocketcandServer | KernelBus
        if bus == "socketcand":
            self.bus = SocketcandServer(self.selector, "127.0.0.1", 0, "can0", self._receive)
        else:
            self.bus = KernelBus(self.selector, int(bus), self._receive)
        self.drives: dict[str, Drive] = {}
        for number, (joint, inertia) in enumerate(INERTIAS.items(), 1):
            network = Network(lambda cob_id, msg: self.bus.send(Frame(cob_id, msg)))
            self.drives[joint] = Drive(number, network, Plant(inertia, *FRICTION), modes)
        self._time = time.monotonic()
        self._orders = socket.create_server(("127.0.0.1", 0))
        self.selector.register(self._orders, selectors.EVENT_READ, self._accept)
        self.running = True

    @property
    def ready(self) -> dict[str, Any]:
        eds = self.drives["joint_1"].node.eds.content
        ports = {"port": self.bus.port, "control_port": self._orders.getsockname()[1]}
        kind = {"identity": [VENDOR, PRODUCT, REVISION], "gear": GEAR, "rated": RATED}
        return ports | kind | {"eds": eds, "inertias": INERTIAS}

    def serve(self) -> None:
        while self.running:
            moving = any(drive.state in ENERGISED for drive in self.drives.values())
            now = time.monotonic()
            for key, mask in self.selector.select(
                min(self._timers.due(now), self.bus.due(now), TICK if moving else 0.1)
            ):
                key.data(mask)
            now = time.monotonic()
            self.bus.run(now)
            self._timers.run(now)
            self._time = max(self._time, now - BACKLOG)
            steps = int((now - self._time) / STEP)
            self._time += steps * STEP
            for drive in self.drives.values():
                drive.run(now, steps)

    def _receive(self, frame: Frame) -> None:
        self._timers.run(time.monotonic())
        for drive in self.drives.values():
            drive.network.receive(frame.id, frame.data)

    # -- orders --------------------------------------------------------------------------------------------------

    def _accept(self, _: int) -> None:
        client, _address = self._orders.accept()
        with client, client.makefile("rw") as lines:
            client.settimeout(5.0)
            request = json.loads(lines.readline())
            lines.write(json.dumps(self._carried_out(request) | {"ok": True}) + "\n")
            lines.flush()

    def _carried_out(self, request: dict[str, Any]) -> dict[str, Any]:
        drive, order = self.drives.get(request.get("joint", "")), request["order"]
        if order == "status":
            syncs = max(each.syncs for each in self.drives.values())
            return {"axes": {joint: _truth(each) for joint, each in self.drives.items()}, "sync_counter": syncs}
        if order == "emergency_stop":
            for each in self.drives.values():
                each.press(request["on"], EMERGENCY_STOP)
            return {}
        orders: dict[str, Callable[[Drive], object]] = {
            "fault": lambda it: it.fail(request["code"]),
            "silence": lambda it: setattr(it.network, "mute", request["on"]),
            "drop_tpdos": lambda it: setattr(it.network, "lose_tpdos", request["count"]),
            "identity": lambda it: it.node.object_dictionary.write(0x1018, 2, request["product"]),
            "velocity_offset": lambda it: it.node.object_dictionary.write(0x60B1, 0, request["raw"]),
            "reboot": lambda it: it.node.nmt.reset(),
        }
        if drive is not None:
            orders[order](drive)
        return {}


def _truth(drive: Drive) -> dict[str, Any]:
    plant, energised = drive.plant, drive.state in ENERGISED
    here = {"position": plant.position, "velocity": plant.velocity, "effort": plant.effort}
    return here | {"energised": energised, "fault": drive.code, "state": drive.state}


def main() -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.ERROR))  # stdout: the ready line
    machine = Machine(*sys.argv[1:])
    signal.signal(signal.SIGTERM, lambda *_: setattr(machine, "running", False))
    print(json.dumps(machine.ready), flush=True)
    machine.serve()


if __name__ == "__main__":
    main()
