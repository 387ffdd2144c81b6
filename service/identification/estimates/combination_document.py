"""The combination of sweeps and trajectories: "combination" of the estimate's document."""

import numpy as np

from service.identification.design.halton import spread_evenly
from service.identification.estimates.combination import POSITIVE, Combination
from service.identification.estimates.standard_document import physical_document, standard_document
from service.identification.estimates.standard_parameters import combined_parameters
from service.identification.model.base_parameters import joint_ranges
from service.identification.model.convergence import unsettled
from service.identification.motion.choice import SIMPLE
from service.model.results import combination as results

POSES = 200  # of the workspace, in which an inertia must be positive
FAR = 3.0  # standard deviations: greatest distance of the base parameters from those of a physical robot
CHECK = "Check signs and units of the efforts, the gear ratios and gravity's direction, or record a longer motion"
SIGN = "The effort of this axis and its velocity seem to count in opposite directions: change the sign of one of them"
UNSETTLED_FIT = 0.5  # standard deviations by which the last round may move the fit of free motions without a warning


def combination_document(combination: Combination) -> results.Combination:
    """All numbers; a standard deviation that a source does not determine is None.

    `became_identifiable`: names of the parameters that are identified by sweeps and trajectories only together.
    """
    parameters, standard = combination.parameters, combined_parameters(combination)
    return results.Combination(
        base_parameters=tuple(
            results.CombinedParameter(
                name=parameter.name,
                value=parameter.value,
                std=_finite(parameter.std),
                std_total=_finite(parameter.std_total),
                std_sweeps=_finite(parameter.std_sweeps),
                std_trajectories=_finite(parameter.std_trajectories),
                std_nominal=parameter.std_prior,
                source=parameter.source.value,
                identified=parameter.identified,
                reason=parameter.reason,
            )
            for parameter in parameters
        ),
        became_identifiable=tuple(parameter.name for parameter in parameters if parameter.by_combination),
        trajectories=combination.trajectories,
        noise={
            joint: results.EffortNoise(harmonic=noise, scatter=combination.scatter[joint]).with_nonempty(
                warning=unsettled(combination.noise_change[joint])
            )
            for joint, noise in combination.noise.items()
        },
        free_motions=combination.free,
        free_motion_axes={joint: _free_motion_axis(combination, joint) for joint in combination.free_axes},
        covariance=tuple(map(tuple, combination.solution.covariance.tolist())),
        standard_parameters=standard_document(combination.robot, standard),
        physical=physical_document(standard),
    ).with_nonempty(free_motion_fit=_fit(combination), warnings=_warnings(combination, standard.deviation))


def _fit(combination: Combination) -> results.FreeMotionFit | None:
    chosen = combination.chosen
    if chosen is None:
        return None
    return results.FreeMotionFit(simple_estimator=SIMPLE, coloured=chosen.coloured, prior_widened=chosen.widened)


def _free_motion_axis(combination: Combination, joint: str) -> results.FreeMotionAxis:
    axis, chosen = combination.free_axes[joint], combination.chosen
    found = results.FreeMotionAxis(
        residual_rms=axis.residual,
        held_out_rms=axis.error,
        held_out_percent=100 * axis.error / combination.robot.axis(joint).rated_effort,
        noise_floor_rms=axis.floor,
    )
    if chosen is None:
        return found
    moved = chosen.fit.moved
    warning = f"the fit of the free motions still moved by {moved:.2g} standard deviations in its last round"
    return found.with_nonempty(
        simple_held_out_rms=chosen.simple[joint],
        friction=_friction(combination, joint),
        lacks=chosen.fit.evidence.lacks.get(joint, ()),
        warning=warning if moved > UNSETTLED_FIT else "",
    )


def _friction(combination: Combination, joint: str) -> tuple[results.FrictionPoint, ...]:
    law = combination.friction.get(joint)
    if law is None:
        return ()
    points = zip(law.speeds.tolist(), law.whole.tolist(), law.std.tolist(), strict=True)
    return tuple(results.FrictionPoint(velocity=speed, effort=effort, std=std) for speed, effort, std in points)


def _warnings(combination: Combination, deviation: float) -> tuple[str, ...]:
    """What no robot can have, with the next step."""
    robot = combination.robot
    found = list(combination.faults)
    for one in combination.parameters:
        if one.name.startswith(POSITIVE) and " " not in one.name and one.value + 2 * one.std < 0:
            mend = SIGN if one.name.startswith("Fc(") else CHECK
            found.append(f"{one.name} is {one.value:.3g} ± {one.std:.2g}: it is positive on every robot. {mend}")
    poses = spread_evenly(POSES, *joint_ranges(robot.chain))
    for joint in robot.joints:
        least = float(combination.inertia(joint, poses).min())
        if least <= 0:
            found.append(f"the inertia of {joint} is {least:.3g} in a pose: it is positive on every robot. {CHECK}")
    if deviation > FAR:
        found.append(
            f"no robot of rigid bodies has these base parameters: the nearest is {deviation:.1f} standard deviations "
            f"away, limit {FAR:g}. {CHECK}"
        )
    return tuple(found)


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
