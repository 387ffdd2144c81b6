"""The initial analysis as JSON-able data: "analysis" of the estimate's document; plans and priors are made from it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from service.identification.axis.ideal_frequency import AxisAnalysis, Figure, Ideal, PoseAnalysis, PoseClass
from service.identification.spectra.noise_response import Response

TRAIN = ("motor_inertia", "motor_friction", "load_friction", "compliance", "damping_time")
_IDEAL = ("inertia", "friction", "locked_rotor", "corner", "frequency")


def analyses_document(analyses: Mapping[str, AxisAnalysis]) -> dict[str, Any]:
    """By joint; floats survive exactly, what is infinite is null. `Z` = effort/velocity, `std` of its parts."""
    return {joint: _axis(analysis) for joint, analysis in analyses.items()}


def analyses_from(document: Mapping[str, Any]) -> dict[str, AxisAnalysis]:
    """The inverse of `analyses_document`."""
    return {joint: _axis_from(joint, axis) for joint, axis in document.items()}


def _axis(analysis: AxisAnalysis) -> dict[str, Any]:
    std = np.sqrt(np.diag(analysis.covariance))
    return {
        "drive_train": {
            name: {"value": float(value), "std": float(sigma)}
            for name, value, sigma in zip(TRAIN, analysis.mean, std, strict=True)
        },
        "covariance": analysis.covariance.tolist(),
        "chi_squared": analysis.chi_squared,
        "classes": [_class(each) for each in analysis.classes],
        "poses": [_pose(pose) for pose in analysis.poses],
    }


def _class(each: PoseClass) -> dict[str, Any]:
    return {
        "name": each.name,
        "inertia_up_to": _finite(each.up_to),
        "locked_rotor": _finite(each.locked_rotor),
        "sweep_frequency": each.sweep_frequency,
    }


def _pose(pose: PoseAnalysis) -> dict[str, Any]:
    response = pose.response
    std = np.sqrt(response.variance(response.impedance) / 2)
    return {
        "pose": list(pose.pose),
        "load_inertia": pose.load_inertia,
        "fit": _ideal(pose.fit),
        "asymptotes": _ideal(pose.asymptotes),
        "frequency_response": [
            {
                "frequency": float(response.frequency[k]),
                "re": float(response.impedance[k].real),
                "im": float(response.impedance[k].imag),
                "std": float(std[k]),
                "coherence": float(response.coherence[k]),
            }
            for k in range(len(std))
        ],
    }


def _ideal(ideal: Ideal) -> dict[str, Any]:
    figures: dict[str, Figure] = {name: getattr(ideal, name) for name in _IDEAL}
    return {
        **{name: {"value": _finite(each.value), "std": _finite(each.std)} for name, each in figures.items()},
        "sweep_frequency": ideal.sweep_frequency,
    }


def _axis_from(joint: str, document: Mapping[str, Any]) -> AxisAnalysis:
    return AxisAnalysis(
        joint=joint,
        mean=np.array([document["drive_train"][name]["value"] for name in TRAIN]),
        covariance=np.array(document["covariance"]),
        chi_squared=document["chi_squared"],
        poses=tuple(_pose_from(pose) for pose in document["poses"]),
    )


def _pose_from(document: Mapping[str, Any]) -> PoseAnalysis:
    lines = document["frequency_response"]
    impedance = np.array([complex(line["re"], line["im"]) for line in lines])
    variance = 2 * np.array([line["std"] for line in lines]) ** 2
    covariance = np.zeros((len(lines), 2, 2), dtype=np.complex128)
    covariance[:, 0, 0] = variance  # at unit velocity all of it is the effort's
    return PoseAnalysis(
        pose=tuple(document["pose"]),
        response=Response(
            np.array([line["frequency"] for line in lines]),
            impedance,
            np.ones_like(impedance),
            covariance,
            np.array([line["coherence"] for line in lines]),
        ),
        load_inertia=document["load_inertia"],
        fit=_ideal_from(document["fit"]),
        asymptotes=_ideal_from(document["asymptotes"]),
    )


def _ideal_from(document: Mapping[str, Any]) -> Ideal:
    return Ideal(*(Figure(_number(document[name]["value"]), _number(document[name]["std"])) for name in _IDEAL))


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.inf if value is None else value
