"""The drive cabinet on a CAN bus: frames and times are its only inputs, frames its only outputs.

While set-points come with SYNC, each SYNC advances the machine by its period.
"""

from collections.abc import Callable, Mapping
from math import inf, tau
from pathlib import Path

from simulator.cabinet import DriveCabinet, VirtualDriveCabinet, joint_limits
from simulator.canopen.node import ForeignNode, VirtualNode
from simulator.canopen.pdo import Frame
from simulator.drive.foreign_axis import ForeignAxis
from simulator.drive.foreign_units import MotorPlate
from simulator.drive.power_drive import Mode
from simulator.drive.virtual_axis import VirtualAxis
from simulator.machine import AxisInfo, LiveMachine
from simulator.scenario import ScenarioError


class CanopenCabinet(VirtualDriveCabinet[VirtualNode]):
    """Virtual drives: node ids 1, 2, ... in the order of the machine's joints. The period of SYNC is 1006h."""

    def __init__(self, machine: LiveMachine, eds: Path, speed_factor: float, send: Callable[[Frame], None]) -> None:
        nodes = {
            info.joint: VirtualNode(number, eds, machine.cycle, send, can_move=not info.locked)
            for number, info in enumerate(machine.axes, 1)
        }
        super().__init__(machine, nodes, speed_factor)

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        if frame.id == 0x80:
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

    def axis_status(self, info: AxisInfo, axis: VirtualAxis) -> dict[str, object]:
        """As on any fieldbus, and the NMT state of the node."""
        return super().axis_status(info, axis) | {"nmt": self.nodes[info.joint].nmt.name.lower()}


class ForeignCabinet(DriveCabinet[ForeignNode]):
    """Drives of other makers: node ids as above; `files`: the EDS or DCF of each joint's drive.

    The period of SYNC is 1006h, else 60C2h, else as measured. If SYNC is missing, real time is the clock, as for a real
    axis. Raises ScenarioError for a joint without a file, or a file of another kind.
    """

    sync_lost = 5.0
    """s after the last SYNC, from which the machine continues in real time."""

    def __init__(
        self, machine: LiveMachine, files: Mapping[str, Path], speed_factor: float, send: Callable[[Frame], None]
    ) -> None:
        limits = joint_limits(machine.scenario.robot.urdf)
        nodes: dict[str, ForeignNode] = {}
        for number, info in enumerate(machine.axes, 1):
            if info.joint not in files:
                raise ScenarioError(f"joint {info.joint}: no dictionary for its drive")
            plate = _plate(info, limits[info.joint])
            file, can_move = files[info.joint], not info.locked
            nodes[info.joint] = ForeignNode(number, file, plate, machine.cycle, send, can_move=can_move)
        super().__init__(machine, nodes, speed_factor)

    def receive(self, frame: Frame, now: float) -> None:
        """A frame of the bus at `now`, s of a monotonic clock."""
        self._now = now
        synced = [node for node in self.nodes.values() if frame.id == node.sync_id]
        for node in synced:
            node.sync(frame.data, now)
        self.switch()
        leader = next((node for node in synced if node.led_by_sync), None)
        if leader is not None:
            self.advance(leader.sync_cycles)
        for node in self.nodes.values():
            if node not in synced:
                node.receive(frame, now)
        self.switch()

    def due(self, now: float) -> float:
        lost = inf
        if self._pace()[0] == 0.0:
            lost = min(
                (node.synced_at + self.sync_lost for node in self.nodes.values() if node.led_by_sync), default=inf
            )
        return min(super().due(now), max(lost - now, 0.0))

    def axis_status(self, info: AxisInfo, axis: ForeignAxis) -> dict[str, object]:
        """Status of one axis; `effort` is the true torque of the motor, N m on the joint side."""
        node = self.nodes[info.joint]
        return super().axis_status(info, axis) | {
            "effort": axis.torque * info.gear_ratio,
            "nmt": node.nmt.name.lower(),
            "maker": node.dictionary.maker.name,
        }

    def _pace(self) -> tuple[float, int]:
        axes = [axis for _, axis in self._axes if axis.energised]
        synced = any(n.led_by_sync and self._now - n.synced_at < self.sync_lost for n in self.nodes.values())
        if not axes or synced:
            return 0.0, 1
        moving = [axis for axis in axes if axis.moving]
        return self._paced(moves=bool(moving), at_speed=all(axis.mode is Mode.PROFILE_POSITION for axis in moving))

    def _torque_limit(self, info: AxisInfo, axis: ForeignAxis) -> float:
        return axis.torque_limit * abs(info.gear_ratio)


def _plate(info: AxisInfo, limits: Mapping[str, float]) -> MotorPlate:
    turns = info.gear_ratio / tau
    ends = sorted((limits["lower"] * turns, limits["upper"] * turns))
    rated = info.rated_effort / abs(info.gear_ratio)
    return MotorPlate(
        gear_ratio=info.gear_ratio,
        rated_torque=rated,
        most_torque=info.effort_limit / abs(info.gear_ratio),
        torque_constant=rated / 10.0,  # A at rated torque, for every motor
        most_speed=limits["velocity"] * abs(turns),
        window=(ends[0], ends[1]),
    )
