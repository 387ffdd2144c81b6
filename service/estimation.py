"""The estimate of a set of spectra as a document: one function for the service's worker and for `sweepid identify`."""

from collections.abc import Sequence
from typing import Any

from service.collision import reachable
from service.identification import Spectrum, as_document, identify
from service.robot import Robot


def estimate_document(robot: Robot, spectra: Sequence[Spectrum]) -> dict[str, Any]:
    """Identify, and compare with the nominal model over the poses of the workspace that the robot can take.

    While only noise and standstill were recorded, nothing is known: a document without axes.
    """
    if not any(spectrum.spec.shows_inertia for spectrum in spectra):
        nothing: dict[str, Any] = {"links": {}, "motor_inertias": {}}
        return {"axes": {}, "base_parameters": [], "condition_number": None, "standard_parameters": nothing}
    estimate = identify(robot, spectra)
    return as_document(estimate, reachable(robot, estimate.poses, estimate.workspace))
