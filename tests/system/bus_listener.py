"""A third party on the bus of a virtual machine: it hears everything, and may speak."""

import struct
import threading
from collections.abc import Generator
from contextlib import contextmanager

import can
import yaml

from drivers.canopen import frames
from drivers.canopen.bus import SocketcandBus
from drivers.cia402.states import Controlword
from tests.system.rest_bench import VirtualMachine

QUICK_STOP = frames.rpdo1(Controlword.QUICK_STOP, 0)
SDO_REQUEST = 0x600


class Ear:
    """Everything that is said on the bus, as (identifier, data), in the order it came."""

    def __init__(self, machine: VirtualMachine) -> None:
        profile = yaml.safe_load(machine.profile.read_text("utf-8"))["bus"]
        self._bus = SocketcandBus("can0", profile["host"], profile["port"], tcp_tune=True)  # nodes send already
        self.heard: list[tuple[int, bytes]] = []
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def close(self) -> None:
        self._closing.set()
        self._thread.join()
        self._bus.shutdown()

    def forget(self) -> None:
        self.heard = []

    def quick_stops(self) -> set[int]:
        """The nodes that were told to stop."""
        return {identifier - frames.Cob.RPDO1 for identifier, data in tuple(self.heard) if data == QUICK_STOP}

    def nmt_stops(self) -> set[int]:
        words = [data for identifier, data in tuple(self.heard) if identifier == frames.Cob.NMT]
        return {data[1] for data in words if data[0] == frames.NmtCommand.STOP}

    def words_of_motion(self) -> list[str]:
        """What closes a loop or moves an axis, by RPDO1 or SDO: enable operation, start of a measuring function."""
        return [f"{identifier:03X}h {data.hex()}" for identifier, data in tuple(self.heard) if _moves(identifier, data)]

    def say(self, identifier: int, data: bytes = b"") -> None:
        """As another host on this bus."""
        self._bus.send(can.Message(arbitration_id=identifier, data=data, is_extended_id=False))

    def _listen(self) -> None:
        while not self._closing.is_set():
            message = self._bus.recv(0.1)
            if message is not None:
                self.heard.append((message.arbitration_id, bytes(message.data)))


@contextmanager
def listening(machine: VirtualMachine) -> Generator[Ear]:
    ear = Ear(machine)
    try:
        yield ear
    finally:
        ear.close()


def _moves(identifier: int, data: bytes) -> bool:
    function = identifier & ~0x7F
    if function == frames.Cob.RPDO1:
        return _enables(struct.unpack_from("<H", data)[0])
    if function == SDO_REQUEST and data[0] & 0xE0 == 0x20:  # expedited download
        entry = struct.unpack_from("<HB", data, 1)
        value = struct.unpack_from("<H", data, 4)[0]
        return (entry == (0x6040, 0) and _enables(value)) or (entry == (0x2100, 1) and value == 1)
    return False


def _enables(controlword: int) -> bool:
    return controlword & 0x0F == Controlword.ENABLE_OPERATION
