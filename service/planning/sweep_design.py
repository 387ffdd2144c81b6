"""Designs the sweep of an axis in a pose from the CAD model, and predicts its information matrix."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.axis.nominal_priors import pose_prior
from service.identification.design.excitation import Excitation, design_sweep
from service.identification.design.pose_selection import sweep_information
from service.identification.model.regressor import gravity_terms, inertia_rows
from service.model.errors import BadInput
from service.model.robot import Robot
from service.planning.candidates import room
from service.planning.documents import PlanRequest
from service.planning.safety.envelope import Envelope

Array = NDArray[np.float64]

TRAVEL_SHARE = 0.95  # of the travel, for the offset motion; the sines oscillate around it


class SweepDesign:
    """The sweeps of a request in its candidates (m, n); `analyses`: initial analyses, by joint, as far as known."""

    def __init__(
        self,
        robot: Robot,
        request: PlanRequest,
        envelope: Envelope,
        candidates: Array,
        analyses: Mapping[str, InitialAnalysis],
    ) -> None:
        self._robot, self._request, self._envelope, self._candidates = robot, request, envelope, candidates
        self._analyses = analyses
        chain, parameters = robot.chain, robot.chain.inertial.ravel()
        index = {joint: robot.index(joint) for joint in request.axes}
        self._load = {joint: inertia_rows(chain, k, candidates) @ parameters for joint, k in index.items()}
        self._gravity = {
            joint: gravity_terms(chain, parameters, robot.gravity, k, candidates) for joint, k in index.items()
        }

    def excitation(self, joint: str, candidate: int) -> Excitation:
        """The sweep of one axis in a candidate pose, forward if there is room, else backward.

        BadInput if no sweep fits.
        """
        envelope, index, pose = self._envelope, self._robot.index(joint), self._candidates[candidate]
        direction = 1 if room(envelope, pose[None], index, 1)[0] else -1
        load = float(self._load[joint][candidate])
        axis = self._robot.axis(joint)
        velocity = envelope.velocity_limit(index)
        # the sines may use the effort that friction and gravity leave, with the CAD inertia wrong by its prior
        prior = self._robot.prior
        reach = (pose[index] - envelope.limits.travel, pose[index] + envelope.limits.travel)
        gravity = (1 + prior.gravity) * envelope.gravity_effort(index, tuple(pose), reach)
        friction = (1 + prior.viscous_friction) * (axis.viscous_friction or 0.0) * velocity
        spare = envelope.effort_limit(index) - gravity - friction - envelope.limits.breakaway * axis.rated_effort
        if not spare > 0:
            raise BadInput(joint, f"gravity of {gravity:.4g} leaves no effort for a sweep in this pose")
        return design_sweep(
            self._robot,
            joint,
            pose,
            load_inertia=load,
            lines=self._lines(joint, load),
            locked_rotor_frequency=self._locked_rotor(joint, candidate),
            direction=direction,
            travel=TRAVEL_SHARE * envelope.limits.travel,
            velocity_limit=velocity,
            effort_limit=spare / (1 + 2 * prior.inertia) / 2,
        )

    def information(self, joint: str, candidate: int, excitation: Excitation) -> Array:
        """Predicted information of a sweep in a candidate on inertia and compliance: `sweep_information` (2, 2)."""
        axis, load = self._robot.axis(joint), float(self._load[joint][candidate])
        total = load + (axis.reflected_motor_inertia or 0.0)
        prior = pose_prior(self._robot, self._robot.index(joint), total, self._gravity[joint][candidate])
        return sweep_information(
            excitation.sines,
            excitation.periods * excitation.period,
            axis.rated_effort,
            load,
            float(prior.sigma[1]),
            self._locked_rotor(joint, candidate),
        )

    def _locked_rotor(self, joint: str, candidate: int) -> float | None:
        """With constant stiffness it is proportional to 1 / sqrt(inertia): lowest where the inertia is largest."""
        if joint in self._analyses:
            found = self._analyses[joint].locked_rotor(float(self._load[joint][candidate]))
            return found if math.isfinite(found) else None
        lowest, load = self._request.locked_rotor.get(joint), self._load[joint]
        return None if lowest is None else lowest * math.sqrt(float(load.max() / load[candidate]))

    def _lines(self, joint: str, load: float) -> list[float]:
        """Those of the request, else those of the initial analysis, else [] for those of the method."""
        if self._request.lines or joint not in self._analyses:
            return sorted(self._request.lines)
        return list(self._analyses[joint].lines(load))
