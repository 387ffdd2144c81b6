"""The torque constants from a known mass, for `sweepid identify --torque-gain`."""

import math

from rich.console import Console
from rich.table import Table

from service.identification.axis.nominal_priors import TorqueGain
from service.identification.estimates.torque_gain import Calibration, KnownMass, torque_gains
from service.identification.spectra.frequency_response import spectrum
from service.model.errors import BadInput
from service.model.robot import Robot
from service.store.files.bundle import Bundle

SENSIBLE = (0.5, 2.0)  # gains of a drive whose motor is the one that it was told of
SHOWN = 3.0  # standard deviations that the added inertia must be above nothing
SMALLEST = 1.0  # m; also a lone axis without a length may carry a mass so far out


def calibrate(before: Bundle, after: Bundle, mass: KnownMass, place: str) -> dict[str, Calibration]:
    """By joint; BadInput where the bundles are not of one robot or share no pose, or cannot be without and with it."""
    if (before.robot.description, before.robot.urdf_text) != (after.robot.description, after.robot.urdf_text):
        raise BadInput(place, f"is not of robot {before.robot.name} of the first bundle: robot file or URDF differs")
    _check_place(before.robot, mass)
    spectra = [
        [spectrum(bundle.robot, sweep) for sweep in bundle.sweeps if sweep.spec.periodic] for bundle in (before, after)
    ]
    found = torque_gains(before.robot, spectra[0], spectra[1], mass)
    for joint, one in found.items():
        _check_shown(joint, one.gain)
    return found


def _check_place(robot: Robot, mass: KnownMass) -> None:
    """The mass hangs no farther from the last joint than the robot is long."""
    joints = robot.chain.joints
    offsets = sum(math.hypot(*joint.translation) for joint in joints)
    travels = sum(abs(joint.upper - joint.lower) for joint in joints if joint.kind == "prismatic")
    longest, away = max(SMALLEST, offsets + travels), math.hypot(*mass.center)
    if away > longest:
        raise BadInput(
            "--center",
            f"is {away:.3g} m from the last joint, limit {longest:.3g} m, the length of the robot's "
            "links: check that the unit is m",
        )


def _check_shown(joint: str, gain: TorqueGain) -> None:
    """A mass that was on, and is what it is said to be, shows, and about as heavy as it is."""
    if not gain.gain > SHOWN * gain.std:
        raise BadInput(
            joint,
            f"the second campaign shows no added inertia beyond its uncertainty (gain {gain.gain:.3f}, "
            f"standard deviation {gain.std:.3f}): check that the mass was mounted, and its units (kg, "
            "m)",
        )
    if not SENSIBLE[0] <= gain.gain <= SENSIBLE[1]:
        raise BadInput(
            joint,
            f"the second campaign shows {gain.gain:.3f} times the inertia that the mass adds, and a "
            f"gain must be within {SENSIBLE[0]} to {SENSIBLE[1]}: check that this mass was mounted, "
            "and its units (kg, m)",
        )


def print_gains(found: dict[str, Calibration]) -> None:
    """One row an axis."""
    table = Table(title="Torque reported by the drive over true torque")
    table.add_column("axis")
    for name in ("gain", "std", "poses", "added inertia, kg m^2"):
        table.add_column(name, justify="right")
    for joint, one in found.items():
        table.add_row(joint, f"{one.gain.gain:.4f}", f"{one.gain.std:.4f}", str(one.poses), f"{one.added:.4g}")
    Console().print(table)
