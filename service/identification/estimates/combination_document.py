"""The combination of sweeps and trajectories: "combination" of the estimate's document."""

import numpy as np

from service.identification.estimates.combination import Combination
from service.results import combination as results


def combination_document(combination: Combination) -> results.Combination:
    """All numbers; a standard deviation that a source does not determine is None.

    `became_identifiable`: names of the parameters that neither sweeps nor trajectories alone identify.
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
            joint: results.EffortNoise(harmonic=noise, scatter=combination.scatter[joint])
            for joint, noise in combination.noise.items()
        },
        free_motions=combination.free,
        free_motion_axes={
            joint: results.FreeMotionAxis(
                residual_rms=axis.residual,
                held_out_rms=axis.error,
                held_out_percent=100 * axis.error / combination.robot.axis(joint).rated_effort,
                noise_floor_rms=axis.floor,
            )
            for joint, axis in combination.free_axes.items()
        },
    )


def _finite(value: float) -> float | None:
    return value if np.isfinite(value) else None
