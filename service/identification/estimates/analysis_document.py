"""The initial analysis as a document: "analysis" of the estimate's document; plans and priors are computed from it."""

import math
from collections.abc import Mapping

import numpy as np

from service.identification.axis.ideal_frequency import AxisAnalysis, Figure, Ideal, PoseAnalysis, PoseClass
from service.identification.spectra.noise_response import Response
from service.model.results import analysis as results
from service.model.results.effect import Value

TRAIN = ("motor_inertia", "motor_friction", "load_friction", "compliance", "damping_time")


def analyses_document(analyses: Mapping[str, AxisAnalysis]) -> dict[str, results.AxisAnalysis]:
    """By joint; floats are stored without loss, infinite values as None. `re`, `im` of effort/velocity, `std` of
    them.
    """
    return {joint: _axis(analysis) for joint, analysis in analyses.items()}


def analyses_from(documents: results.Analyses) -> dict[str, AxisAnalysis]:
    """The inverse of `analyses_document`."""
    return {joint: _axis_from(joint, axis) for joint, axis in documents.items()}


def _axis(analysis: AxisAnalysis) -> results.AxisAnalysis:
    std = np.sqrt(np.diag(analysis.covariance))
    return results.AxisAnalysis(
        drive_train={
            name: Value(value=float(value), std=float(sigma))
            for name, value, sigma in zip(TRAIN, analysis.mean, std, strict=True)
        },
        covariance=tuple(map(tuple, analysis.covariance.tolist())),
        chi_squared=analysis.chi_squared,
        classes=tuple(_class(each) for each in analysis.classes),
        poses=tuple(_pose(pose) for pose in analysis.poses),
    )


def _class(each: PoseClass) -> results.PoseClass:
    return results.PoseClass(
        name=each.name,
        inertia_up_to=_finite(each.up_to),
        locked_rotor=_finite(each.locked_rotor),
        sweep_frequency=each.sweep_frequency,
    )


def _pose(pose: PoseAnalysis) -> results.AnalysedPose:
    response = pose.response
    std = np.sqrt(response.variance(response.impedance) / 2)
    return results.AnalysedPose(
        pose=pose.pose,
        load_inertia=pose.load_inertia,
        fit=_ideal(pose.fit),
        asymptotes=_ideal(pose.asymptotes),
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


def _ideal(ideal: Ideal) -> results.Ideal:
    return results.Ideal(
        inertia=_figure(ideal.inertia),
        friction=_figure(ideal.friction),
        locked_rotor=_figure(ideal.locked_rotor),
        corner=_figure(ideal.corner),
        frequency=_figure(ideal.frequency),
        sweep_frequency=ideal.sweep_frequency,
    )


def _figure(figure: Figure) -> results.Figure:
    return results.Figure(value=_finite(figure.value), std=_finite(figure.std))


def _axis_from(joint: str, document: results.AxisAnalysis) -> AxisAnalysis:
    return AxisAnalysis(
        joint=joint,
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
        response=Response(
            np.array([line.frequency for line in lines]),
            impedance,
            np.ones_like(impedance),
            covariance,
            np.array([line.coherence for line in lines]),
        ),
        load_inertia=document.load_inertia,
        fit=_ideal_from(document.fit),
        asymptotes=_ideal_from(document.asymptotes),
    )


def _ideal_from(document: results.Ideal) -> Ideal:
    return Ideal(
        inertia=_figure_from(document.inertia),
        friction=_figure_from(document.friction),
        locked_rotor=_figure_from(document.locked_rotor),
        corner=_figure_from(document.corner),
        frequency=_figure_from(document.frequency),
    )


def _figure_from(figure: results.Figure) -> Figure:
    return Figure(_number(figure.value), _number(figure.std))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.inf if value is None else value
