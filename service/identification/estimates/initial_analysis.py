"""The initial analysis of a robot from its noise runs and stepped sines: groups the runs by pose and adds the
priors.
"""

from collections.abc import Sequence

import numpy as np

from service.identification.axis.ideal_frequency import AxisAnalysis, analyse_axis
from service.identification.axis.nominal_priors import pose_prior, shared_prior
from service.identification.estimates.estimate import SAME_POSITION
from service.identification.model.regressor import axis_rows, gravity_terms
from service.identification.spectra.frequency_response import Spectrum
from service.identification.spectra.noise_response import NoiseSpectrum, Response, noise_response, stepped_response
from service.model.recording import SweepSpec
from service.model.robot import Robot

FEWEST_LINES = 8  # of a pose: with fewer, resonance and friction cannot be separated


def analyse(robot: Robot, runs: Sequence[NoiseSpectrum], stepped: Sequence[Spectrum] = ()) -> dict[str, AxisAnalysis]:
    """The analysis of every axis with enough lines in a pose; an axis with noise runs needs no stepped sines.

    Runs of one axis with equal positions of the other joints belong to one pose: its own position does not change
    its inertia.
    """
    analyses: dict[str, AxisAnalysis] = {}
    for number, joint in enumerate(robot.joints):
        noise = [run for run in runs if run.spec.axis == joint]
        sines = [sweep for sweep in stepped if sweep.spec.axis == joint]
        groups = (
            [(found, noise_response([noise[k] for k in found])) for found in _poses(number, [r.spec for r in noise])]
            if noise
            else [
                (found, stepped_response([sines[k] for k in found]))
                for found in _poses(number, [s.spec for s in sines])
            ]
        )
        specs = [each.spec for each in (noise or sines)]
        enough = [(specs[found[0]], answer) for found, answer in groups if len(answer.frequency) >= FEWEST_LINES]
        if enough:
            analyses[joint] = _axis(robot, number, [spec for spec, _ in enough], [answer for _, answer in enough])
    return analyses


def _poses(number: int, specs: Sequence[SweepSpec]) -> list[list[int]]:
    """Numbers of the sweeps of each pose, in the order of their ids."""
    groups: list[list[int]] = []
    for k in sorted(range(len(specs)), key=lambda k: specs[k].id):
        for group in groups:
            apart = np.abs(np.subtract(specs[k].pose, specs[group[0]].pose))
            if np.delete(apart, number).max(initial=0.0) < SAME_POSITION:
                group.append(k)
                break
        else:
            groups.append([k])
    return groups


def _axis(robot: Robot, number: int, specs: Sequence[SweepSpec], responses: Sequence[Response]) -> AxisAnalysis:
    poses = np.array([spec.pose for spec in specs])
    motors = [axis.reflected_motor_inertia or 0.0 for axis in robot.axes]
    nominal = np.concatenate([robot.chain.inertial.ravel(), motors])
    reference = axis_rows(robot.chain, number, poses) @ nominal
    gravity = gravity_terms(robot.chain, nominal, robot.gravity, number, poses)
    shown = [_as_spectrum(spec, response) for spec, response in zip(specs, responses, strict=True)]
    return analyse_axis(
        robot.joints[number],
        [spec.pose for spec in specs],
        responses,
        shared_prior(robot, number, reference, shown),
        [pose_prior(robot, number, float(reference[k]), gravity[k]) for k in range(len(specs))],
    )


def _as_spectrum(spec: SweepSpec, response: Response) -> Spectrum:
    """The lines of a response at unit velocity, as needed for the data sheet's prior."""
    lines = len(response.frequency)
    return Spectrum(
        spec=spec,
        samples=2 * lines,
        frequency=response.frequency,
        line=np.ones(lines, dtype=bool),
        effort=response.impedance,
        velocity=np.ones(lines, dtype=np.complex128),
        names=(),
        regressors=np.empty((0, lines), dtype=np.complex128),
    )
