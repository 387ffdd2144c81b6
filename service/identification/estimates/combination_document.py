"""The combination of sweeps and trajectories: "combination" of the estimate's document."""

import numpy as np

from service.identification.estimates.combination import Combination
from service.identification.model.convergence import unsettled
from service.identification.motion.held_out import HeldOut
from service.results import combination as results

UNSETTLED_FIT = 0.5  # standard deviations by which the last round may move the fit of free motions without a warning


def combination_document(combination: Combination) -> results.Combination:
    """All numbers; a standard deviation that a source does not determine is None.

    `became_identifiable`: names of the parameters that are identified by sweeps and trajectories only together.
    """
    parameters = combination.parameters
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
        free_motion_axes={
            joint: _free_motion_axis(axis, combination.robot.axis(joint).rated_effort, combination.free_moved)
            for joint, axis in combination.free_axes.items()
        },
    )


def _free_motion_axis(axis: HeldOut, rated_effort: float, moved: float) -> results.FreeMotionAxis:
    found = results.FreeMotionAxis(
        residual_rms=axis.residual,
        held_out_rms=axis.error,
        held_out_percent=100 * axis.error / rated_effort,
        noise_floor_rms=axis.floor,
    )
    warning = f"the fit of the free motions still moved by {moved:.2g} standard deviations in its last round"
    return found.with_nonempty(warning=warning if moved > UNSETTLED_FIT else "")


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
