"""Connects designed sweeps to a path: legs, limits and start time of each, checked against the envelope."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.model.errors import EnvelopeViolation
from service.model.robot import Robot
from service.planning.diagnosis.documents import DiagnosisRequest, ExperimentRequest
from service.planning.documents import DroppedPose, PlannedLeg, PlannedSweep
from service.planning.safety.envelope import Envelope
from service.planning.sweep_sequence import LEG_OVERHEAD

Array = NDArray[np.float64]
Place = tuple[tuple[float, ...], str]  # pose and block


class DesignedWay:
    """Collects the sweeps along the path. A block that is not possible in a pose is omitted there with all repeats."""

    def __init__(
        self, robot: Robot, request: DiagnosisRequest | ExperimentRequest, envelope: Envelope, home: Array
    ) -> None:
        self._robot, self._request, self._envelope = robot, request, envelope
        self._refused: dict[Place, str] = {}
        self._clock = 0.0
        self.here: list[float] = home.tolist()
        self.sweeps: list[PlannedSweep] = []

    @property
    def dropped(self) -> tuple[DroppedPose, ...]:
        """The omitted sweeps: poses, each with the blocks that have the same reason."""
        blocks: dict[tuple[tuple[float, ...], str], list[str]] = {}
        for (pose, block), reason in self._refused.items():
            blocks.setdefault((pose, reason), []).append(block)
        return tuple(
            DroppedPose(pose=pose, reason=f"{', '.join(names)}: {reason}") for (pose, reason), names in blocks.items()
        )

    def follow(self, designed: Iterable[DesignedSweep]) -> None:
        """Add sweeps in their order."""
        for sweep in designed:
            place = (sweep.spec.pose, sweep.spec.block)
            if place in self._refused:
                continue
            try:
                self._add(sweep)
            except EnvelopeViolation as error:
                self._refused[place] = str(error)

    def _add(self, designed: DesignedSweep) -> None:
        spec, index = designed.spec, self._robot.index(designed.spec.axis)
        legs = self._envelope.order_of_legs(self.here, spec.pose)
        planned = self._planned(designed, index)
        self._envelope.check_sweep(planned.command(), spec.pose)
        pose, way = list(self.here), 0.0
        for joint, target in legs:
            way += abs(target - pose[joint])
            pose[joint] = target
        travelling = way / self._request.move_velocity + LEG_OVERHEAD * (len(legs) + 1)
        self.sweeps.append(
            planned.model_copy(
                update={
                    "legs": tuple(PlannedLeg(joint=self._robot.joints[k], target=target) for k, target in legs),
                    "spec": planned.spec.model_copy(update={"started_at": self._clock + travelling}),
                    "duration": travelling + designed.duration,
                }
            )
        )
        self._clock += self.sweeps[-1].duration
        self.here = list(spec.pose)
        self.here[index] += _travel(designed)

    def _planned(self, designed: DesignedSweep, index: int) -> PlannedSweep:
        """The sweep with its limits, without legs."""
        spec, envelope = designed.spec, self._envelope
        sway = sum(sine.amplitude / (math.pi * sine.frequency) for sine in spec.sines)
        margin = envelope.limits.window_margin + sway
        low, high = sorted((spec.pose[index], spec.pose[index] + _travel(designed)))
        return PlannedSweep(
            spec=spec.model_copy(update={"id": f"{len(self.sweeps) + 1:04d}"}),
            mode=self._request.mode,
            ramp=designed.ramp,
            settle=designed.settle,
            velocity_limit=envelope.velocity_limit(index),
            effort_limit=envelope.effort_limit(index),
            position_window=(low - margin, high + margin),
            legs=(),
            duration=designed.duration,
        )


def _travel(designed: DesignedSweep) -> float:
    """Signed distance from start to end, rad (m)."""
    return designed.spec.offset_velocity * (designed.duration - designed.ramp)
