"""A virtual machine tool: a plant with more physics than the identification models, behind real fieldbus servers.

Public interface for the service's twin (other top packages import nothing else from here): `run_sweeps`,
`run_trajectories`, `replay` with `warmth`, and their data types.

Each name is imported at its first use: the commands of the virtual machine print their help without a plant.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simulator.effects.thermal_order import Turn, warmth
    from simulator.moving_axis import MovingAxis
    from simulator.replaying import Motion, replay
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

_MODULES = {
    "Appendage": "scenario",
    "DriveTrain": "scenario",
    "DrivenAxis": "scenario",
    "Friction": "scenario",
    "GearError": "scenario",
    "Gravity": "rigid_body",
    "Hose": "scenario",
    "LinkDeviation": "scenario",
    "LuGre": "scenario",
    "Measurement": "scenario",
    "Motion": "replaying",
    "MovingAxis": "moving_axis",
    "NoiseRun": "sweeps",
    "Patch": "scenario",
    "PowerLaw": "scenario",
    "Ripple": "scenario",
    "Scenario": "scenario",
    "ScenarioError": "scenario",
    "SpeedControl": "scenario",
    "Spring": "scenario",
    "Stribeck": "scenario",
    "SweepRun": "sweeps",
    "Turn": "effects.thermal_order",
    "Warming": "scenario",
    "Waveform": "waveform",
    "load_scenario": "scenario",
    "replay": "replaying",
    "run_sweeps": "sweeps",
    "run_trajectories": "trajectories",
    "true_inertia": "truth",
    "warmth": "effects.thermal_order",
}

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


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
