"""Traces as a CNC exports them, made from simulated sweeps: German numbers, a trigger some time before the motion."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from service.identification.design.excitation import Excitation, way
from service.model import Robot
from service.planning.documents import PlannedSweep
from simulator import Scenario, run_sweeps
from tests.numeric.campaign import run_of

Array = NDArray[np.float64]
HEAD = ("CYCLE", "ENC_POS", "DES_POS", "CMD_SPEED", "TORQUE")
AFTER = 0.3  # s of standstill recorded after the motion


def excitation(planned: PlannedSweep) -> Excitation:
    spec = planned.spec
    assert spec.period is not None
    assert spec.periods is not None
    return Excitation(spec.offset_velocity, spec.sines, spec.period, spec.periods, planned.ramp, planned.settle)


def simulate(scenario: Scenario, sweeps: list[PlannedSweep], seed: int) -> list[dict[str, Array]]:
    """Columns of the sweeps at 1 kHz."""
    runs = [run_of(planned.spec, planned.ramp, planned.settle, sample_rate=1000.0) for planned in sweeps]
    return run_sweeps(scenario, runs, seed)


def cnc_columns(planned: PlannedSweep, robot: Robot, columns: Mapping[str, Array], trigger: int) -> dict[str, Array]:
    """The trace's channels at 250 Hz; the motion starts `trigger` ms after it. deg, motor rev/min, motor N m."""
    axis = robot.axis(planned.spec.axis)
    turn = 60 * axis.gear_ratio / (2 * np.pi)
    start = planned.spec.pose[robot.index(planned.spec.axis)]
    count = trigger + len(columns["time"]) + round(1000 * AFTER)
    count -= count % 4

    def whole(name: str) -> Array:
        still = {"velocity": 0.0, "velocity_setpoint": 0.0}
        values = columns[name]
        before, after = still.get(name, values[0]), still.get(name, values[-1])
        record = np.concatenate([np.full(trigger, before), values, np.full(count, after)])[:count]
        return np.asarray(record, np.float64)

    def sampled(values: Array) -> Array:
        return np.asarray(values.reshape(-1, 4).mean(axis=1), np.float64)

    desired = start + way(excitation(planned), (np.arange(count) + 0.5 - trigger) / 1000)
    return {
        "CYCLE": 17.0 + np.arange(count // 4, dtype=np.float64),
        "ENC_POS": np.degrees(sampled(whole("position"))).astype(np.float64),
        "DES_POS": np.degrees(sampled(desired)).astype(np.float64),
        "CMD_SPEED": turn * sampled(whole("velocity_setpoint")),
        "TORQUE": sampled(whole("effort")) / axis.gear_ratio,
    }


def write_trace(path: Path, columns: Mapping[str, Array]) -> None:
    """Semicolons between the numbers and a comma in each."""
    formats = {"CYCLE": "%d", "ENC_POS": "%.7f", "DES_POS": "%.7f", "CMD_SPEED": "%.5f", "TORQUE": "%.5f"}
    rows = zip(*(columns[name] for name in HEAD), strict=True)
    form = ";".join(formats[name] for name in HEAD)
    lines = [";".join(HEAD), *(form % row for row in rows)]
    path.write_text("\n".join(lines).replace(".", ",") + "\n")
