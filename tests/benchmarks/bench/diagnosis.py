"""Diagnosis of one axis of the second plant, against the time in which the machine measures its sweeps."""

import statistics
from collections.abc import Iterator

from service.diagnosis import diagnose_axis
from tests.benchmarks.bench.measured import Measured, timed
from tests.numeric.second_plant.cases import Case, Kind, case, make

CASES = {
    "nothing hidden": case(11, 1000, Kind.NONE, (), "none"),
    "Coulomb friction": case(11, 20_000, Kind.SINGLE, ("coulomb_friction",)),
    "elasticity": case(11, 21_000, Kind.SINGLE, ("joint_elasticity",)),
    "cogging": case(11, 22_000, Kind.SINGLE, ("cogging_torque",)),
}


def diagnosed(one: Case) -> tuple[float, float, str]:
    """s of the processor, s of the machine, and the verdict."""
    robot, joint, sweeps, _ = make(one)
    seconds, found = timed(lambda: diagnose_axis(robot, joint, sweeps))
    machine = sum(float(sweep.recording.time[-1] - sweep.recording.time[0]) for sweep in sweeps)
    return seconds, machine, f"{len(sweeps)} sweeps: {found.verdict.value}"


def run() -> Iterator[Measured]:
    told = {name: diagnosed(one) for name, one in CASES.items()}
    for name, (seconds, machine, verdict) in told.items():
        yield Measured(
            name=f"diagnosis of one axis, {name}", unit="s", ours=seconds, peer=machine,
            beside="measuring its sweeps", note=verdict,
        )  # fmt: skip
    seconds = [each for each, _, _ in told.values()]
    yield Measured(name="diagnosis of one axis, median of these", unit="s", ours=statistics.median(seconds))
