"""Drives in one process whose dictionaries a test may falsify, and every frame that anybody sends on their bus."""

import os
import queue
import selectors
import socket
import threading
import uuid
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from typing import Any, cast

import can

from drivers.canopen.profile import parse_profile
from drivers.commission.drive import CheckSheet
from drivers.commission.survey import survey
from drivers.registry import load_profile
from simulator.machine import LiveMachine
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive
from tests.contract.makers import profile as makers_profile
from tests.foreign_bench import ROOT, SCENARIO, Foreign, file_of

DRIVES = ROOT / "config" / "drives"
OWN = "virtual"  # the virtual drive's own dictionary
PATIENCE = {"sdo_timeout": 10.0, "drive_timeout": 20.0, "host_heartbeat": 0.01}  # s

Plant = Callable[["Cabinet"], None]


@dataclass(frozen=True)
class Cabinet:
    """`drives[0]` is node 1 of joint_1. A plant changes a dictionary while the bus is silent; `restored` undoes it."""

    virtual: VirtualDrive
    profile: dict[str, Any]
    ear: can.BusABC
    desk: "Desk"

    def dictionary(self, joint: str = "joint_1") -> Any:
        return cast(Any, self.virtual.cabinet).nodes[joint].dictionary

    def node(self, joint: str = "joint_1") -> Any:
        return cast(Any, self.virtual.cabinet).nodes[joint]

    def check(self, **changes: Any) -> CheckSheet:
        """A survey of these drives by their profile with other values."""
        return survey(parse_profile(self.profile | changes, DRIVES), "test.yaml")

    def heard(self) -> list[can.Message]:
        """Every frame since the last question."""
        found: list[can.Message] = []
        while (message := self.ear.recv(0)) is not None:
            found.append(message)
        return found

    @contextmanager
    def planted(self, plant: Plant) -> Iterator[None]:
        """With `plant` done to dictionaries or nodes, which boot as new afterwards."""
        before = [
            (node, copy(node.dictionary._variables), copy(node.dictionary.nameplate), node.number)
            for node in cast(Any, self.virtual.cabinet).nodes.values()
        ]

        def restore() -> None:
            for node, variables, nameplate, number in before:
                node.disturbance.mute = False
                node.number = number
                node.dictionary._variables = variables
                node.dictionary.nameplate = nameplate
                node.boot()

        try:
            self.desk.done(lambda: plant(self))
            yield
        finally:
            self.desk.done(restore)


class Desk:
    """Work on the drives in the thread that owns them, between two of its steps."""

    def __init__(self, virtual: VirtualDrive) -> None:
        """Before that thread starts."""
        self._ours, self._theirs = socket.socketpair()
        self._work: queue.SimpleQueue[tuple[Callable[[], None], Future[None]]] = queue.SimpleQueue()
        cast(Any, virtual)._selector.register(self._theirs, selectors.EVENT_READ, self._serve)

    def done(self, call: Callable[[], None]) -> None:
        """Once it is; raises what it raised."""
        future: Future[None] = Future()
        self._work.put((call, future))
        self._ours.send(b"\0")
        future.result(60)

    def close(self) -> None:
        self._ours.close()
        self._theirs.close()

    def _serve(self, _: int) -> None:
        self._theirs.recv(1)
        call, future = self._work.get()
        try:
            call()
        except BaseException as error:  # noqa: BLE001 - the test's, not the drives'
            future.set_exception(error)
        else:
            future.set_result(None)


@contextmanager
def cabinet(kind: str, joints: int = 2) -> Iterator[Cabinet]:
    """`virtual`, or a dictionary of `tests.foreign_bench`; the profile has the first `joints` axes."""
    machine = LiveMachine(load_scenario(SCENARIO), 0)
    channel = f"commission-{os.getpid()}-{uuid.uuid4()}"
    eds: Any = (
        ROOT / "config" / "eds" / "virtual-axis.eds" if kind == OWN else dict.fromkeys(machine.joints, file_of(kind))
    )
    virtual = VirtualDrive(machine, eds, bus="virtual", channel=channel)
    thread = threading.Thread(target=virtual.run, name="virtual-drive")
    ear, desk = can.Bus(interface="virtual", channel=channel), Desk(virtual)
    thread.start()
    try:
        bus: dict[str, Any] = {"interface": "virtual", "channel": channel, "host": None, "port": None}
        content: dict[str, Any] = (
            load_profile(DRIVES / "virtual-max100.yaml")
            if kind == OWN
            else makers_profile(kind, Foreign(bus, 0, eds), DRIVES)
        )
        content |= {"bus": content["bus"] | bus | PATIENCE, "axes": content["axes"][:joints]}
        yield Cabinet(virtual, content, ear, desk)
    finally:
        virtual.stop()
        thread.join()
        virtual.close()
        desk.close()
        ear.shutdown()


def words_of_energy(frames: list[can.Message]) -> list[str]:
    """Frames that could give energy or move: what writes 6040h, 6060h or a target, RPDOs, NMT start, SYNC."""
    found: list[str] = []
    for frame in frames:
        function, data = frame.arbitration_id & ~0x7F, bytes(frame.data)
        if frame.arbitration_id == 0 and data[:1] == b"\x01":
            found.append(f"NMT start to {data[1]}")
        elif frame.arbitration_id == 0x80:
            found.append("SYNC")
        elif function in (0x200, 0x300, 0x400, 0x500):
            found.append(f"RPDO {frame.arbitration_id:03X}h")
        elif function == 0x600 and data[0] >> 5 == 1:  # initiate download
            index = int.from_bytes(data[1:3], "little")
            if index in (0x6040, 0x6060, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60C1, 0x60FF):
                found.append(f"write of {index:04X}h")
    return found
