"""The initial analysis of a robot from its noise runs and stepped sines: groups the runs by pose and adds the
priors.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from service.identification.axis.ideal_frequency import InitialAnalysis, PoseAnalysis, analyse_axis
from service.identification.axis.nominal_priors import pose_prior, shared_prior
from service.identification.model import SAME_POSITION, axis_rows, gravity_terms, inertial_parameters
from service.identification.spectra.frequency_response import Spectrum
from service.identification.spectra.noise_response import (
    FrequencyResponse,
    NoiseSpectrum,
    noise_response,
    stepped_response,
)
from service.model import Robot, SweepSpec
from service.model.results import estimate as results
from service.model.results.effect import Value


def analyse(
    robot: Robot, runs: Sequence[NoiseSpectrum], stepped: Sequence[Spectrum] = ()
) -> dict[str, InitialAnalysis]:
    """The analysis of every axis with enough lines in a pose; an axis with noise runs needs no stepped sines.

    Runs of one axis with equal positions of the other joints belong to one pose: its own position does not change
    its inertia.
    """
    analyses: dict[str, InitialAnalysis] = {}
    for number, joint in enumerate(robot.joints):
        noise = [run for run in runs if run.spec.axis == joint]
        sines = [sweep for sweep in stepped if sweep.spec.axis == joint]
        specs = [each.spec for each in (noise or sines)]
        enough: dict[int, FrequencyResponse] = {}
        for found in _poses(number, specs):
            response = (
                noise_response([noise[k] for k in found]) if noise else stepped_response([sines[k] for k in found])
            )
            # with fewer lines, resonance and friction cannot be separated
            if len(response.frequency) >= 8:
                enough[found[0]] = response
        if enough:
            analyses[joint] = _axis(robot, number, [specs[k] for k in enough], list(enough.values()))
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


def _axis(
    robot: Robot, number: int, specs: Sequence[SweepSpec], responses: Sequence[FrequencyResponse]
) -> InitialAnalysis:
    poses = np.array([spec.pose for spec in specs])
    nominal = inertial_parameters(robot)
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


def _as_spectrum(spec: SweepSpec, response: FrequencyResponse) -> Spectrum:
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


TRAIN = ("motor_inertia", "motor_friction", "load_friction", "compliance", "damping_time")


def analyses_document(analyses: Mapping[str, InitialAnalysis]) -> dict[str, results.AxisAnalysis]:
    """By joint; floats are stored without loss, infinite values as None. `re`, `im` of effort/velocity, `std` of
    them.
    """
    return {joint: _axis_analysis(analysis) for joint, analysis in analyses.items()}


def analyses_from(documents: results.Analyses) -> dict[str, InitialAnalysis]:
    """The inverse of `analyses_document`."""
    return {joint: _axis_from(axis) for joint, axis in documents.items()}


def _axis_analysis(analysis: InitialAnalysis) -> results.AxisAnalysis:
    std = np.sqrt(np.diag(analysis.covariance))
    return results.AxisAnalysis(
        drive_train={
            name: Value(value=float(value), std=float(sigma))
            for name, value, sigma in zip(TRAIN, analysis.mean, std, strict=True)
        },
        covariance=tuple(map(tuple, analysis.covariance.tolist())),
        chi_squared=analysis.chi_squared,
        classes=analysis.classes,
        poses=tuple(_pose(pose) for pose in analysis.poses),
    )


def _pose(pose: PoseAnalysis) -> results.AnalysedPose:
    response = pose.response
    std = np.sqrt(response.variance(response.impedance) / 2)
    return results.AnalysedPose(
        pose=pose.pose,
        load_inertia=pose.load_inertia,
        fit=pose.fit,
        asymptotes=pose.asymptotes,
        frequency_response=tuple(
            results.AnalysedLine(
                frequency=float(response.frequency[k]),
                re=float(response.impedance[k].real),
                im=float(response.impedance[k].imag),
                std=float(std[k]),
                coherence=float(response.coherence[k]),
            )
            for k in range(len(std))
        ),
    )


def _axis_from(document: results.AxisAnalysis) -> InitialAnalysis:
    return InitialAnalysis(
        mean=np.array([document.drive_train[name].value for name in TRAIN]),
        covariance=np.array(document.covariance),
        chi_squared=document.chi_squared,
        poses=tuple(_pose_from(pose) for pose in document.poses),
    )


def _pose_from(document: results.AnalysedPose) -> PoseAnalysis:
    lines = document.frequency_response
    impedance = np.array([complex(line.re, line.im) for line in lines])
    variance = 2 * np.array([line.std for line in lines]) ** 2
    covariance = np.zeros((len(lines), 2, 2), dtype=np.complex128)
    covariance[:, 0, 0] = variance  # at unit velocity all of the variance is that of the effort
    return PoseAnalysis(
        pose=document.pose,
        response=FrequencyResponse(
            np.array([line.frequency for line in lines]),
            impedance,
            np.ones_like(impedance),
            covariance,
            np.array([line.coherence for line in lines]),
        ),
        load_inertia=document.load_inertia,
        fit=document.fit,
        asymptotes=document.asymptotes,
    )
