"""A virtual machine tool: a plant with more physics than the identification models, behind real fieldbus servers.

Public interface for the service's twin (other top packages import nothing else from here): `run_sweeps`,
`run_trajectories`, `replay` with `warmth`, and their data types.
"""

from simulator.effects.thermal_order import Turn, warmth
from simulator.moving_axis import MovingAxis
from simulator.replay import Motion, replay
from simulator.rigid_body import Gravity
from simulator.scenario import (
    Appendage,
    DrivenAxis,
    DriveTrain,
    Friction,
    GearError,
    Hose,
    LinkDeviation,
    LuGre,
    Measurement,
    Patch,
    PowerLaw,
    Ripple,
    Scenario,
    ScenarioError,
    SpeedControl,
    Spring,
    Stribeck,
    Warming,
    load_scenario,
)
from simulator.sweeps import NoiseRun, SweepRun, run_sweeps
from simulator.trajectories import run_trajectories
from simulator.truth import true_inertia
from simulator.waveform import Waveform

__all__ = [
    "Appendage",
    "DriveTrain",
    "DrivenAxis",
    "Friction",
    "GearError",
    "Gravity",
    "Hose",
    "LinkDeviation",
    "LuGre",
    "Measurement",
    "Motion",
    "MovingAxis",
    "NoiseRun",
    "Patch",
    "PowerLaw",
    "Ripple",
    "Scenario",
    "ScenarioError",
    "SpeedControl",
    "Spring",
    "Stribeck",
    "SweepRun",
    "Turn",
    "Warming",
    "Waveform",
    "load_scenario",
    "replay",
    "run_sweeps",
    "run_trajectories",
    "true_inertia",
    "warmth",
]
