"""A CANopen master made of the `canopen` package, and what one does with a CiA 402 drive."""

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest
from canopen.profiles.p402 import BaseNode402
from canopen.sdo.exceptions import SdoAbortedError

from tests.foreign_bench import Foreign

PATIENCE = 30.0  # s; a busy computer
SHUT_DOWN, SWITCH_ON, ENABLE, QUICK_STOP, RESET = 0x06, 0x07, 0x0F, 0x02, 0x80
PERIOD = 8  # ms, of SYNC


class Master:
    """One drive of a cabinet: booted, NMT pre-operational."""

    def __init__(self, network: Any, foreign: Foreign, joint: str = "joint_1") -> None:
        self.network, self.foreign, self.joint = network, foreign, joint
        number = list(foreign.files).index(joint) + 1
        self.node: Any = BaseNode402(number, str(foreign.files[joint]))
        network.add_node(self.node)
        self.node.sdo.RESPONSE_TIMEOUT = PATIENCE
        for limit in ("CHECK_TPDO", "RESET_FAULT", "SWITCH_OP_MODE", "SWITCH_STATE_FINAL", "SWITCH_STATE_SINGLE"):
            setattr(self.node, f"TIMEOUT_{limit}", PATIENCE)  # the package gives a drive 0.2 to 0.8 s
        self.emergencies: list[int] = []
        self.node.emcy.add_callback(lambda error: self.emergencies.append(error.code))
        self.reset()

    def reset(self) -> None:
        """Reset the node and wait for its boot-up message."""
        booted = threading.Event()
        self.network.subscribe(0x700 + self.node.id, lambda _id, data, _time: booted.set() if data == b"\0" else None)
        self.network.send_message(0, [129, self.node.id])
        assert booted.wait(PATIENCE)

    def read(self, index: int, subindex: int = 0) -> bytes:
        return self.node.sdo.upload(index, subindex)

    def number(self, index: int, subindex: int = 0) -> int:
        """The value of an object, as its data type says."""
        return self.node.object_dictionary.get_variable(index, subindex).decode_raw(self.read(index, subindex))

    def write(self, index: int, subindex: int, value: int, size: int) -> None:
        self.node.sdo.download(index, subindex, value.to_bytes(size, "little", signed=value < 0))

    def refused(self, code: int, index: int, subindex: int, value: int, size: int) -> None:
        """A download is aborted with `code`."""
        with pytest.raises(SdoAbortedError) as caught:
            self.write(index, subindex, value, size)
        assert f"{caught.value.code:08X}" == f"{code:08X}"

    def map(self, kind: str, number: int, *objects: int, sync: int = 1) -> Any:
        """Map (index << 16 | sub << 8) objects into PDO `number` and save it, as the package does it."""
        pdo = getattr(self.node, kind)[number]
        if not pdo.com_record[1].od.writable:
            return self._map_fixed(pdo, objects, sync)
        pdo.clear()
        for entry in objects:
            pdo.add_variable(entry >> 16, entry >> 8 & 0xFF)
        pdo.trans_type, pdo.enabled = sync, True
        pdo.save()
        return pdo

    def _map_fixed(self, pdo: Any, objects: tuple[int, ...], sync: int) -> Any:
        """The package writes the COB-ID, come what may; this drive lets nobody."""
        mapping = pdo.map_array[0].od.index
        self.write(mapping, 0, 0, 1)
        for sub, entry in enumerate(objects, 1):
            bits = len(self.node.object_dictionary.get_variable(entry >> 16, entry >> 8 & 0xFF))
            self.write(mapping, sub, entry | bits, 4)
        self.write(mapping, 0, len(objects), 1)
        self.write(pdo.com_record[2].od.index, 2, sync, 1)
        pdo.read()
        return pdo

    def enabled(self, mode: int, target: int) -> "Cycle":
        """In operation, at standstill where it is."""
        cycle = Cycle(self, target)
        self.write(0x6060, 0, mode, 1)
        cycle.enable()
        return cycle

    def settle(self, condition: Callable[[], bool]) -> None:
        """Wait for a condition."""
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline, "condition never came true"
            time.sleep(0.01)

    def truth(self) -> dict[str, Any]:
        return self.foreign.truth(self.joint)


class Cycle:
    """Set-points by a synchronous RPDO, actual values by synchronous TPDOs: one call of `run` a lockstep of SYNCs."""

    def __init__(self, master: Master, target: int) -> None:
        self._master = master
        node = master.node
        node.tpdo.read()
        node.rpdo.read()
        self.rpdo = master.map("rpdo", 1, 0x60400000, target)
        self.state = master.map("tpdo", 1, 0x60410000, 0x606C0000, 0x60770000)
        self.place = master.map("tpdo", 2, 0x60640000)
        if 0x60C2 in node.object_dictionary:
            master.write(0x60C2, 1, PERIOD, 1)
            master.write(0x60C2, 2, -3, 1)
        self._answered = threading.Event()
        self.place.add_callback(lambda _: self._answered.set())
        node.nmt.state = "OPERATIONAL"

    def run(self, controlword: int, target: Callable[[int], int] | int, cycles: int) -> tuple[int, int, int, int]:
        """Statusword, velocity, torque, position as they are with the last SYNC."""
        for k in range(cycles):
            self.rpdo[0].raw = controlword
            self.rpdo[1].raw = target(k) if callable(target) else target
            self.rpdo.transmit()
            self.sync()
        return self.state[0].raw, self.state[1].raw, self.state[2].raw, self.place[0].raw

    def sync(self) -> None:
        """One SYNC, and wait for both TPDOs of it."""
        self._answered.clear()
        self._master.network.sync.transmit()
        assert self._answered.wait(PATIENCE)

    def enable(self, target: int = 0) -> None:
        """To OPERATION ENABLED, step by step."""
        for word, state in ((SHUT_DOWN, 0x21), (SWITCH_ON, 0x23), (ENABLE, 0x27)):
            self.run(word, target, 1)
            assert self.run(word, target, 1)[0] & 0x6F == state
