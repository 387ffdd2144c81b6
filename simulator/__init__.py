"""A virtual machine tool: a plant with more physics than the identification models, behind real fieldbus servers.

Public interface for the service's twin (other top packages import nothing else from here): `run_sweeps`,
`run_trajectories`, `replay` with `warmth`, and their data types.

Each name is imported at its first use: the commands of the virtual machine print their help without a plant.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simulator.effects import Turn as Turn
    from simulator.effects import warmth as warmth
    from simulator.replaying import Motion as Motion
    from simulator.replaying import replay as replay
    from simulator.rigid_body import Gravity as Gravity
    from simulator.rigid_body import MovingAxis as MovingAxis
    from simulator.rigid_body import true_inertia as true_inertia
    from simulator.scenario import Appendage as Appendage
    from simulator.scenario import Cogging as Cogging
    from simulator.scenario import DrivenAxis as DrivenAxis
    from simulator.scenario import DriveTrain as DriveTrain
    from simulator.scenario import Friction as Friction
    from simulator.scenario import GearError as GearError
    from simulator.scenario import Hose as Hose
    from simulator.scenario import LinkDeviation as LinkDeviation
    from simulator.scenario import LuGre as LuGre
    from simulator.scenario import Measurement as Measurement
    from simulator.scenario import Patch as Patch
    from simulator.scenario import PowerLaw as PowerLaw
    from simulator.scenario import Scenario as Scenario
    from simulator.scenario import ScenarioError as ScenarioError
    from simulator.scenario import SpeedControl as SpeedControl
    from simulator.scenario import Spring as Spring
    from simulator.scenario import Stribeck as Stribeck
    from simulator.scenario import Warming as Warming
    from simulator.scenario import load_scenario as load_scenario
    from simulator.sweeps import NoiseRun as NoiseRun
    from simulator.sweeps import SweepRun as SweepRun
    from simulator.sweeps import run_sweeps as run_sweeps
    from simulator.sweeps import run_trajectories as run_trajectories
    from simulator.waveform import Waveform as Waveform

_PAGES = {
    "effects": "Turn warmth",
    "replaying": "Motion replay",
    "rigid_body": "Gravity MovingAxis true_inertia",
    "scenario": "Appendage DriveTrain DrivenAxis Friction GearError Hose LinkDeviation LuGre Measurement Patch "
    "PowerLaw Cogging Scenario ScenarioError SpeedControl Spring Stribeck Warming load_scenario",
    "sweeps": "NoiseRun SweepRun run_sweeps run_trajectories",
    "waveform": "Waveform",
}


def __getattr__(name: str) -> object:
    for page, names in _PAGES.items():
        if name in names.split():
            return getattr(import_module(f"{__name__}.{page}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
