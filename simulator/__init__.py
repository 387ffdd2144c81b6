"""A virtual machine tool: a plant that knows more physics than any fit, behind real fieldbus servers.

Public face for the service's twin (nothing else of this package may be imported by another room):
`run_sweeps`, `replay`, and their data types.
"""

from simulator.moving_axis import MovingAxis
from simulator.replay import Motion, replay
from simulator.rigid_body import Gravity
from simulator.scenario import (
    DrivenAxis,
    DriveTrain,
    Friction,
    LinkDeviation,
    LuGre,
    Measurement,
    Ripple,
    Scenario,
    ScenarioError,
    SpeedControl,
    Spring,
    load_scenario,
)
from simulator.sweeps import NoiseRun, SweepRun, run_sweeps
from simulator.truth import true_inertia
from simulator.waveform import Waveform

__all__ = [
    "DriveTrain",
    "DrivenAxis",
    "Friction",
    "Gravity",
    "LinkDeviation",
    "LuGre",
    "Measurement",
    "Motion",
    "MovingAxis",
    "NoiseRun",
    "Ripple",
    "Scenario",
    "ScenarioError",
    "SpeedControl",
    "Spring",
    "SweepRun",
    "Waveform",
    "load_scenario",
    "replay",
    "run_sweeps",
    "true_inertia",
]
