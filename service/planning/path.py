"""The path of the robot through the sweeps of a plan: each with the legs to its pose, its limits and its start."""

import math
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Generic, TypeVar

from drivers.ports import SweepMode
from service import BadInput
from service.identification.design.diagnosis_sweeps import DesignedSweep
from service.identification.design.excitation import Excitation
from service.model import Array, Robot, SweepSpec
from service.planning.documents import PlannedLeg, PlannedNoise, PlannedSweep
from service.planning.safety.envelope_check import Envelope

LEG_OVERHEAD = 1.0  # s to switch an axis on, settle and switch it off
Planned = TypeVar("Planned", bound=PlannedSweep | PlannedNoise)


class SweepPath(Generic[Planned]):
    """Collects sweeps. `here`: positions of all axes after the last one, rad (m); `duration` of all, s."""

    def __init__(self, robot: Robot, envelope: Envelope, home: Array, move_velocity: float) -> None:
        if move_velocity > (limit := envelope.limits.move_velocity):
            raise BadInput("move_velocity", f"{move_velocity} is above the limit {limit} rad/s (m/s)")
        self._robot, self._envelope, self._velocity = robot, envelope, move_velocity
        self.here: list[float] = home.tolist()
        self.sweeps: list[Planned] = []
        self.duration = 0.0

    def way_to(self, pose: Sequence[float]) -> tuple[tuple[PlannedLeg, ...], float]:
        """The legs from here to a pose, and their time, s. EnvelopeViolation if there is no free path."""
        legs, at, way = self._envelope.order_of_legs(self.here, pose), list(self.here), 0.0
        for joint, target in legs:
            way += abs(target - at[joint])
            at[joint] = target
        planned = tuple(PlannedLeg(joint=self._robot.joints[joint], target=target) for joint, target in legs)
        return planned, way / self._velocity + LEG_OVERHEAD * (len(legs) + 1)

    def of_sines(
        self, spec: SweepSpec, mode: SweepMode, design: Excitation | DesignedSweep, travel: float
    ) -> PlannedSweep:
        """A sweep with its limits, without legs. `travel`: signed, from start to end, rad (m)."""
        index = self._robot.index(spec.axis)
        sway = sum(sine.amplitude / (math.pi * sine.frequency) for sine in spec.sines)
        return PlannedSweep(
            spec=spec,
            mode=mode,
            ramp=design.ramp,
            settle=design.settle,
            velocity_limit=self._envelope.velocity_limit(index),
            effort_limit=self._envelope.effort_limit(index),
            position_window=self.window(spec.pose[index], travel, sway),
            legs=(),
            duration=design.duration,
        )

    def window(self, start: float, travel: float, sway: float) -> tuple[float, float]:
        """Positions at which a sweep is stopped, rad (m): those of its travel, of its sines or noise, and a margin."""
        low, high = sorted((start, start + travel))
        margin = self._envelope.limits.window_margin + sway
        return low - margin, high + margin

    def add(self, sweep: Planned, travel: float) -> None:
        """Add a sweep that moves its axis by `travel`, rad (m). EnvelopeViolation if it may not."""
        self.add_together([sweep], [travel])

    def add_together(self, sweeps: Sequence[Planned], travels: Sequence[float]) -> None:
        """Add sweeps that run at the same time; the first contains the legs. EnvelopeViolation if they may not."""
        pose = sweeps[0].spec.pose
        legs, travelling = self.way_to(pose)
        self._envelope.check_run([sweep.command() for sweep in sweeps], pose)
        started_at, self.here = self.duration + travelling, list(pose)
        for number, (sweep, travel) in enumerate(zip(sweeps, travels, strict=True)):
            first = number == 0
            spec = sweep.spec.model_copy(update={"id": f"{len(self.sweeps) + 1:04d}", "started_at": started_at})
            duration = travelling + sweep.duration if first else 0.0
            change = {"spec": spec, "legs": legs if first else (), "duration": duration}
            self.sweeps.append(sweep.model_copy(update=change))
            self.duration += duration
            self.here[self._robot.index(spec.axis)] += travel

    @contextmanager
    def all_or_none(self) -> Generator[None]:
        """What the block adds is removed again if it raises."""
        here, duration, count = self.here, self.duration, len(self.sweeps)
        try:
            yield
        except BaseException:
            self.here, self.duration = here, duration
            del self.sweeps[count:]
            raise
