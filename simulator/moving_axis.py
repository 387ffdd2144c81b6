"""One axis of a scenario in one pose: all data that the plant needs."""

from collections.abc import Sequence
from dataclasses import dataclass

from simulator.rigid_body import Gravity, RigidBody
from simulator.scenario import DriveTrain, Scenario, ScenarioError


@dataclass(frozen=True, slots=True)
class MovingAxis:
    """A row of the plant. Load inertia in kg m^2 about the joint, without the motor."""

    train: DriveTrain
    gear_ratio: float  # motor revolutions per joint revolution
    load_inertia: float
    gravity: Gravity
    warmth: float = 0.0  # temperature rise of the gear at the start, K

    @property
    def motor_inertia(self) -> float:
        """Motor inertia on the joint side, kg m^2."""
        return self.train.motor_inertia * self.gear_ratio**2


def moving_axis(scenario: Scenario, body: RigidBody, joint: str, pose: Sequence[float]) -> MovingAxis:
    """A joint with the robot in `pose` (n,) rad. Raises ScenarioError if it is locked or the pose does not fit."""
    if len(pose) != len(scenario.joints):
        raise ScenarioError(f"{joint}: pose has {len(pose)} positions, the robot {len(scenario.joints)} joints")
    driven, number = scenario.driven(joint), scenario.joints.index(joint)
    return MovingAxis(
        train=driven.train,
        gear_ratio=scenario.nominal(joint).gear_ratio,
        load_inertia=float(body.inertia(pose)[number]),
        gravity=body.gravity(number, pose),
    )
