r"""Does the robot still agree with a sheet? Comparison with a later estimate, with significance.

For each axis k measured in both, the mean inertia over the poses of the later measurement, from the sheet's base
parameters beta with covariance C (W_k: mean row) and from the later ones

    d_k = W_k' beta' - W_k beta,     cov d = W' C' W'^T + W C W^T,     z_k = d_k / std d_k

and for all axes together ``chi2 = d^T (cov d)^-1 d`` with one degree of freedom per axis. If the later measurement is
too small to identify beta' (a daily check), the mean of its sweeps replaces W' beta', with the mean of their standard
deviations, as if their errors were fully correlated. All of this assumes the same torque constants, that is the
same drives.
"""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from service.formats.export.sheets.inertias import Inertias, of_estimate, of_sheet
from service.formats.export.sheets.making import check_sheet
from service.model.errors import BadInput
from service.model.results.estimate import Estimate
from service.model.results.sheet import AxisCheck, Sheet, SheetCheck, SheetVerdict
from service.model.robot import Robot

Array = NDArray[np.float64]

# two-sided probabilities of 2 and 4 standard deviations, which are also the limits of the daily check
SAME: Final = 0.0455
CHANGED: Final = 6.33e-5


def compare(sheet: Sheet, robot: Robot, estimate: Estimate, poses: Mapping[str, Array], place: str) -> SheetCheck:
    """The sheet compared with a later estimate of `robot`; `poses` (m, n), rad (m): those measured later, by axis.

    BadInput: an altered sheet, another robot, no common axis, or an inertia that one of them does not determine.
    """
    check_sheet(sheet, "sheet")
    if sheet.robot != robot.name:
        raise BadInput("sheet", f"is of robot {sheet.robot}, and {place} of {robot.name}")
    serial = robot.description.serial or ""
    if sheet.serial and serial and sheet.serial != serial:
        raise BadInput("sheet", f"is of serial number {sheet.serial}, and {place} of {serial}")
    before, after = of_sheet(robot, sheet, "sheet"), of_estimate(robot, estimate, place)
    joints = [joint for joint in before.joints if joint in after.joints and len(poses.get(joint, ()))]
    if not joints:
        raise BadInput(place, f"has no axis of the sheet: it has {', '.join(after.joints)}")
    old, covariance = _modelled(before, joints, poses)
    if all(after.knows(joint, poses[joint]) for joint in joints):
        new, own = _modelled(after, joints, poses)
    else:
        new, own = _measured(estimate, joints)
    covariance = covariance + own
    std = np.sqrt(np.diag(covariance))
    if not std.min() > 0:
        raise BadInput(
            place, f"gives {joints[int(np.argmin(std))]} without uncertainty: the significance cannot be computed"
        )
    difference = new - old
    probability = _probability(difference / std, covariance / np.outer(std, std))
    axes = tuple(
        AxisCheck(
            joint=joint,
            sheet=float(old[k]),
            now=float(new[k]),
            std=float(std[k]),
            differs_percent=100 * float(difference[k] / old[k]),
            differs_in_std=float(difference[k] / std[k]),
            poses=len(poses[joint]),
        )
        for k, joint in enumerate(joints)
    )
    return SheetCheck(
        robot=robot.name,
        fingerprint=sheet.fingerprint,
        source=place,
        verdict=_verdict(probability),
        probability=probability,
        axes=axes,
        not_compared=tuple(joint for joint in before.joints if joint not in joints),
    )


def _modelled(of: Inertias, joints: Sequence[str], poses: Mapping[str, Array]) -> tuple[Array, Array]:
    """Mean inertia (k,) of each axis over its poses by the base parameters, and its covariance (k, k)."""
    rows = np.array([of.rows(joint, poses[joint]).mean(axis=0) for joint in joints])
    return rows @ of.values, rows @ of.covariance @ rows.T


def _measured(estimate: Estimate, joints: Sequence[str]) -> tuple[Array, Array]:
    """The same from the sweeps alone."""
    sweeps = [estimate.axes[joint].inertia for joint in joints]
    means = np.array([float(np.mean([sweep.value for sweep in own])) for own in sweeps])
    stds = np.array([float(np.mean([sweep.std for sweep in own])) for own in sweeps])
    return means, np.diag(stds**2)


def _probability(standardised: Array, correlation: Array) -> float:
    """Probability of at least this difference by chance, for all axes together."""
    distance = float(standardised @ np.linalg.lstsq(correlation, standardised, rcond=None)[0])
    return float(chi2.sf(distance, np.linalg.matrix_rank(correlation)))


def _verdict(probability: float) -> SheetVerdict:
    if probability >= SAME:
        return "the same"
    return "perhaps changed" if probability >= CHANGED else "changed"
