"""A virtual machine tool: a plant with more physics than the identification models, behind real fieldbus servers.

Public interface for the service's twin (other top packages import nothing else from here): `run_sweeps`,
`run_trajectories`, `replay` with `warmth`, and their data types.

Each name is imported at its first use: the commands of the virtual machine print their help without a plant.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simulator.effects import Turn as Turn, warmth as warmth
    from simulator.rigid_body import Gravity as Gravity, MovingAxis as MovingAxis, true_inertia as true_inertia
    from simulator.scenario import (
        DrivenAxis as DrivenAxis,
        DriveTrain as DriveTrain,
        Friction as Friction,
        LinkDeviation as LinkDeviation,
        Measurement as Measurement,
        Scenario as Scenario,
        ScenarioError as ScenarioError,
        SpeedControl as SpeedControl,
        load_scenario as load_scenario,
    )
    from simulator.sweeps import (
        Motion as Motion,
        NoiseRun as NoiseRun,
        SweepRun as SweepRun,
        replay as replay,
        run_sweeps as run_sweeps,
        run_trajectories as run_trajectories,
    )
    from simulator.waveform import Waveform as Waveform

_PAGES = {
    "effects": "Turn warmth",
    "rigid_body": "Gravity MovingAxis true_inertia",
    "scenario": "DriveTrain DrivenAxis Friction LinkDeviation Measurement Scenario ScenarioError SpeedControl "
    "load_scenario",
    "sweeps": "Motion NoiseRun SweepRun replay run_sweeps run_trajectories",
    "waveform": "Waveform",
}


def __getattr__(name: str) -> object:
    for page, names in _PAGES.items():
        if name in names.split():
            return getattr(import_module(f"{__name__}.{page}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
