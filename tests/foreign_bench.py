"""A cabinet of other makers' drives on a real bus, for any host: `with bench(dictionary="epos4") as foreign: ...`.

`plain` is in `config/eds`; the makers' dictionaries are read from ../shared, and a test that asks for one is skipped
where that folder is absent.
"""

import os
import threading
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simulator.canopen.line import ForeignCabinet
from simulator.machine import LiveMachine
from simulator.scenario import load_scenario
from simulator.virtual_drive import VirtualDrive
from tests.conftest import shared_folder
from tests.ports import ordered

ROOT = Path(__file__).resolve().parents[1]
SCENARIO = ROOT / "config" / "scenarios" / "max100-full.yaml"
PLAIN = "plain"
MAKERS = {
    "epos4": "maxon-epos4-50-15.dcf",
    "gold": "elmo-gold.dcf",
    "simpliq": "elmo-simpliq.dcf",
    "powerball": "schunk-powerball.dcf",
}


def file_of(dictionary: str) -> Path:
    """The EDS or DCF of a drive family; skips the test if it lies in ../shared and that is absent."""
    if dictionary == PLAIN:
        return ROOT / "config" / "eds" / "plain-402.eds"
    return shared_folder() / "data" / "drives" / MAKERS[dictionary]


@dataclass(frozen=True)
class Foreign:
    """A running cabinet: the arguments of `can.Bus` that lead to it, and its control port."""

    bus: Mapping[str, Any]
    control_port: int
    files: Mapping[str, Path]  # by joint; node ids 1, 2, ... in this order

    def order(self, order: str, **fields: object) -> dict[str, Any]:
        """Any order of the control port."""
        return ordered(self.control_port, order, **fields)

    def truth(self, joint: str = "joint_1") -> dict[str, Any]:
        """What the machine really does, SI units of the joint."""
        return self.order("status")["axes"][joint]


@contextmanager
def bench(
    dictionary: str | Mapping[str, str] = PLAIN,
    *,
    bus: str = "virtual",
    scenario: Path = SCENARIO,
    speed_factor: float = 20.0,
) -> Iterator[Foreign]:
    """Drives of one family, or of one by joint: on python-can's `virtual` bus, on socketcand at loopback, or on vcan0
    (`socketcan`).
    """
    machine = LiveMachine(load_scenario(scenario), 0)
    names = {joint: dictionary if isinstance(dictionary, str) else dictionary[joint] for joint in machine.joints}
    files = {joint: file_of(name) for joint, name in names.items()}
    channels = {"socketcand": "can0", "socketcan": "vcan0"}
    channel = channels.get(bus, f"foreign-{os.getpid()}-{uuid.uuid4()}")
    virtual = VirtualDrive(machine, files, bus=bus, channel=channel, speed_factor=speed_factor)
    assert isinstance(virtual.cabinet, ForeignCabinet)
    thread = threading.Thread(target=virtual.run, name="foreign-drive")
    thread.start()
    try:
        arguments: dict[str, Any] = {"interface": bus, "channel": channel}
        if bus == "socketcand":
            arguments |= {"host": "127.0.0.1", "port": virtual.port}
        yield Foreign(arguments, virtual.control_port, files)
    finally:
        virtual.stop()
        thread.join()
        virtual.close()
