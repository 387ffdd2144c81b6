"""The drive cabinet on a CAN bus: frames and times are its only inputs, frames its only outputs.

While an axis is in cyclic synchronous velocity, each SYNC advances the machine by one communication cycle 1006h.
"""

from collections.abc import Callable
from pathlib import Path

from simulator import cabinet
from simulator.canopen.node import SYNC_ID, Frame, Node
from simulator.drive.axis import Axis
from simulator.machine import AxisInfo, Machine


class Cabinet(cabinet.Cabinet[Node]):
    """Node ids 1, 2, ... in the order of the machine's joints."""

    def __init__(self, machine: Machine, eds: Path, speed_factor: float, send: Callable[[Frame], None]) -> None:
        nodes = {
            info.joint: Node(number, eds, machine.cycle, send, can_move=not info.locked)
            for number, info in enumerate(machine.axes, 1)
        }
        super().__init__(machine, nodes, speed_factor)

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        if frame.id == SYNC_ID:
            for node in self.nodes.values():
                node.sync(now)
            self.switch()
            leader = next((node for node in self.nodes.values() if node.axis.interpolating), None)
            if leader is not None:
                self.advance(round(leader.dictionary[0x1006, 0] * 1e-6 / self._machine.cycle))
        else:
            for node in self.nodes.values():
                node.receive(frame, now)
        self.switch()

    def status(self) -> dict[str, object]:
        """As on any fieldbus, and the SYNC counter."""
        counter = max(node.dictionary[0x2120, 1] for node in self.nodes.values())
        return super().status() | {"sync_counter": counter}

    def axis_status(self, info: AxisInfo, axis: Axis) -> dict[str, object]:
        """As on any fieldbus, and the NMT state of the node."""
        return super().axis_status(info, axis) | {"nmt": self.nodes[info.joint].nmt.name.lower()}
