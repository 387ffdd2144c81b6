"""Figures 1a and 1b of the paper from the initial analysis of an axis ("analysis" of an estimate's document)."""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from service.identification.axis.drive_train import impedance
from service.identification.axis.ideal_frequency import InitialAnalysis, PoseAnalysis
from service.model import Array, Complex
from service.model.results.part import with_std
from service.report.drawing import (
    DECADES,
    IDENTIFIED,
    MEASURED,
    REFERENCE,
    Drawn,
    DrawnFigure,
    Part,
    figure,
    line,
    note,
    panels,
    points,
    rounded,
    scale,
    upright,
)

_LOG = {"type": "log", "tickvals": [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 40]}


def amplitude_responses(analysis: InitialAnalysis, *, linear: bool = False) -> DrawnFigure:
    """Fig. 1a: velocity over effort in every pose, measured (dots) and fitted (lines), from light to heavy.

    `linear`: of a prismatic axis.
    """
    traces: list[Part] = []
    poses = sorted(analysis.poses, key=lambda pose: pose.fit.inertia.value)
    for number, pose in enumerate(poses):
        share = number / max(len(poses) - 1, 1)
        # colours of the lightest and the heaviest pose
        mixed = (1 - share) * np.array([14, 165, 233]) + share * np.array([124, 45, 18])
        colour = "#" + "".join(f"{int(value):02x}" for value in mixed)
        frequency = pose.response.frequency
        name = f"J = {pose.fit.inertia.value:.0f} {_unit(linear)}"
        measured = points(name, rounded(frequency), 1 / np.abs(pose.response.impedance), colour, size=4)
        fine = _fine(frequency)
        fitted = line(name, rounded(fine), 1 / np.abs(_fitted(analysis, pose, fine)), colour, width=1.2)
        traces += [{**measured, "showlegend": False}, fitted]
    return figure(
        traces,
        {
            "height": 460,
            "xaxis": {**scale("frequency in Hz"), **_LOG},
            "yaxis": {**scale(f"|Ω/Γ| in {'m/s per N' if linear else 'rad/s per N m'}"), **DECADES},
        },
    )


def ideal_frequencies(analysis: InitialAnalysis, *, linear: bool = False) -> DrawnFigure:
    """Fig. 1b in every pose: apparent inertia |Z|/ω, its asymptotes, and the ideal frequency between their ends."""
    poses = sorted(analysis.poses, key=lambda pose: pose.fit.inertia.value)
    traces: list[Part] = []
    annotations: list[Drawn] = []
    shapes: list[Drawn] = []
    layout: dict[str, Drawn] = {
        "height": 40 + 290 * -(-len(poses) // 3),
        "showlegend": False,
        "annotations": annotations,
        "shapes": shapes,
    }
    for pose, (here, left, top, width, height) in zip(poses, panels(len(poses)), strict=True):
        number, ends = str(here["xaxis"])[1:], _ends(pose)
        traces += [{**trace, **here} for trace in _one_pose(analysis, pose, ends)]
        layout[f"xaxis{number}"] = {
            **scale("frequency in Hz"),
            **_LOG,
            "tickvals": [0.1, 1, 10],
            "domain": [left + 0.13 * width, left + 0.97 * width],
            "anchor": here["yaxis"],
            "range": [math.log10(end) for end in ends],
        }
        layout[f"yaxis{number}"] = {
            **scale(f"|Γ/Ω|/ω in {_unit(linear)}" if left == 0 else ""),
            **DECADES,
            "domain": [top - 0.8 * height, top - 0.12 * height],
            "anchor": here["xaxis"],
        }
        told = f"J = {pose.fit.inertia.value:.0f} {_unit(linear)}, ideal {_ideal(pose, '.2g')} Hz → "
        annotations.append(note(f"{told}{pose.fit.sweep_frequency:.0f} Hz", left + 0.13 * width, top - 0.1 * height))
        shapes += [
            upright(number, frequency, colour, 1.2, "dot")
            for frequency, colour in (
                (pose.fit.corner.value, REFERENCE),
                (pose.fit.frequency.value, IDENTIFIED),
                (pose.fit.locked_rotor.value, REFERENCE),
            )
            if math.isfinite(frequency) and frequency > 0
        ]
    return figure(traces, layout)


def table(
    analyses: Mapping[str, InitialAnalysis], joints: Sequence[str], linear: Collection[str] = ()
) -> tuple[list[str], list[list[str]]]:
    """Head and rows, by pose: from the fit, in brackets from asymptotes.

    `linear`: the prismatic ones of all `joints` of the robot.
    """
    slides = {number for number, joint in enumerate(joints) if joint in linear}
    places, sizes = ("deg, linear axes mm", "kg m², linear axes kg") if linear else ("deg", "kg m²")
    head = ["axis", f"pose in {places}", f"J in {sizes}", "locked rotor in Hz", "friction corner in Hz", "ideal in Hz"]
    rows: list[list[str]] = []
    for joint in joints:
        for pose in analyses[joint].poses if joint in analyses else ():
            fit, read = pose.fit, pose.asymptotes
            rows.append(
                [
                    joint,
                    ", ".join(f"{1e3 * at if k in slides else math.degrees(at):.0f}" for k, at in enumerate(pose.pose)),
                    " ± ".join(with_std(fit.inertia.value, fit.inertia.std)),
                    _locked_rotor(pose),
                    f"{' ± '.join(with_std(fit.corner.value, fit.corner.std))} ({read.corner.value:.2f})",
                    f"{_ideal(pose, '.2f')} → {fit.sweep_frequency:.0f}",
                ]
            )
    return head, rows


def _unit(linear: bool) -> str:
    return "kg" if linear else "kg m²"


def _locked_rotor(pose: PoseAnalysis) -> str:
    if pose.at_least is not None:  # the asymptotes then end at a resonance that does not exist
        return f"above {pose.at_least[0]:.0f}"
    found = pose.fit.locked_rotor
    return f"{' ± '.join(with_std(found.value, found.std))} ({pose.asymptotes.locked_rotor.value:.1f})"


def _ideal(pose: PoseAnalysis, digits: str) -> str:
    found = pose.fit.frequency.value
    return f"{found:{digits}}" if pose.at_least is None else f"above {pose.at_least[1]:{digits}}"


def _one_pose(analysis: InitialAnalysis, pose: PoseAnalysis, ends: tuple[float, float]) -> list[Part]:
    frequency, read = pose.response.frequency, pose.asymptotes
    omega = 2 * np.pi * frequency
    fine = np.geomspace(ends[0], ends[1], 400)
    measured = points("measured", rounded(frequency), np.abs(pose.response.impedance) / omega, MEASURED, size=3.5)
    level = np.array([ends[0], read.locked_rotor.value])
    friction = np.array([ends[0], max(3 * read.corner.value, 3 * ends[0])])
    resistance = max(read.friction.value, 1e-9) / (2 * np.pi * friction)
    return [
        measured,
        line("fit", rounded(fine), np.abs(_fitted(analysis, pose, fine)) / (2 * np.pi * fine), IDENTIFIED, width=1.2),
        line("inertia", rounded(level), np.full(2, read.inertia.value), "#475569", "dash", 1.2),
        line("friction", rounded(friction), resistance, "#475569", "dash", 1.2),
    ]


def _fitted(analysis: InitialAnalysis, pose: PoseAnalysis, frequency: Array) -> Complex:
    return impedance(frequency, analysis.train, pose.load_inertia, 0.0).total


def _ends(pose: PoseAnalysis) -> tuple[float, float]:
    """From half the friction corner frequency, if plausible, to the last line."""
    return max(min(0.5 * pose.fit.corner.value, 0.5), 0.02), float(pose.response.frequency[-1])


def _fine(frequency: Array) -> Array:
    return np.geomspace(float(frequency[0]), float(frequency[-1]), 300)
