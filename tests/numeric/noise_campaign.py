"""Simulated initial analyses: scenario -> noise runs -> spectra, with the truth kept apart."""

from dataclasses import asdict, dataclass

import numpy as np

from service.identification.axis.ideal_frequency import InitialAnalysis
from service.identification.design.excitation import design_noise
from service.identification.estimates.initial_analysis import analyse
from service.identification.model import inertia_rows
from service.identification.spectra.noise_response import NoiseSpectrum, noise_spectrum
from service.model import Recording, Robot, Sweep, SweepSpec
from simulator import DriveTrain, NoiseRun, Scenario, load_scenario, run_sweeps, true_inertia
from tests.numeric.campaign import CONFIG, max100

POSES = np.array(
    [[0.0, q2, q3, 0, 0, 0] for q2, q3 in zip(np.linspace(-1, 1, 6), np.linspace(1, -1.8, 6), strict=True)]
)


@dataclass(frozen=True)
class SimulatedAnalysis:
    robot: Robot
    scenario: Scenario
    joint: str
    sweeps: tuple[Sweep, ...]

    @property
    def spectra(self) -> list[NoiseSpectrum]:
        return [noise_spectrum(self.robot, sweep) for sweep in self.sweeps]

    @property
    def analysis(self) -> InitialAnalysis:
        return analyse(self.robot, self.spectra)[self.joint]

    @property
    def train(self) -> DriveTrain:
        return self.scenario.driven(self.joint).train

    @property
    def true_train(self) -> np.ndarray:
        """In the order of `service.identification.axis.drive_train.DriveTrain`."""
        train, gear = self.train, self.robot.axis(self.joint).gear_ratio
        motor, load, spring = train.motor_friction.viscous, train.load_friction.viscous, train.spring
        assert spring is not None
        return np.array(
            [train.motor_inertia * gear**2, motor, load, 1 / spring.stiffness, spring.damping / spring.stiffness]
        )

    @property
    def true_inertia(self) -> np.ndarray:
        """Of the axis in `POSES`."""
        return true_inertia(self.scenario, self.joint, POSES)


def measure_noise(name: str, joint: str, seed: int, repeats: int = 2, poses: np.ndarray = POSES) -> SimulatedAnalysis:
    """Noise runs of a joint of scenario `name` in poses (n, 6), forward and backward `repeats` times in each."""
    robot, scenario = max100(), load_scenario(CONFIG / f"scenarios/{name}.yaml")
    number = robot.index(joint)
    loads = inertia_rows(robot.chain, number, poses) @ robot.chain.inertial.ravel()
    specs: list[SweepSpec] = []
    runs: list[NoiseRun] = []
    for pose, load in zip(poses.tolist(), loads, strict=True):
        motor = robot.axis(joint).reflected_motor_inertia
        assert motor is not None
        inertia = float(load) + motor
        for direction in (1, -1) * repeats:
            design = design_noise(
                robot, joint, inertia=inertia, travel=0.066, seed=100 * seed + len(specs), direction=direction
            )
            fields = {name: value for name, value in asdict(design).items() if name != "sines"}
            runs.append(NoiseRun(axis=joint, pose=tuple(pose), sample_rate=1000.0, **fields))
            specs.append(
                SweepSpec(
                    id=f"{len(specs) + 1:04}",
                    axis=joint,
                    pose=tuple(pose),
                    offset_velocity=design.offset_velocity,
                    excitation="noise",
                    period=design.period,
                    periods=design.periods,
                    measure_from=design.measure_from,
                    sample_rate=1000.0,
                )
            )
    recordings = [Recording(**columns) for columns in run_sweeps(scenario, runs, seed)]
    return SimulatedAnalysis(robot, scenario, joint, tuple(map(Sweep, specs, recordings)))
