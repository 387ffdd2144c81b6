"""The shipped scenarios, and how to take effects out of them; a dictionary, and an axis that follows exactly."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simulator import Measurement, Scenario, SweepRun, load_scenario
from simulator.drive.dictionary import ObjectDictionary
from simulator.drive.measuring import DriveSamples
from simulator.drive.virtual_axis import VirtualAxis

CONFIG = Path(__file__).parents[3] / "config"
EDS = CONFIG / "eds" / "virtual-axis.eds"
CYCLE = 0.001


def line(columns: dict[str, np.ndarray], name: str, frequency: float, sweep: SweepRun) -> complex:
    """Complex amplitude of one channel over the measured window."""
    time = columns["time"]
    start = sweep.waveform.measure_from
    inside = (time >= start - 1e-9) & (time < start + sweep.period * sweep.periods - 1e-9)
    return complex(2 * np.mean(columns[name][inside] * np.exp(-2j * np.pi * frequency * time[inside])))


@pytest.fixture
def scenario() -> Callable[[str], Scenario]:
    """Scenario by short name: full, rigid, misfit."""
    return lambda name: load_scenario(CONFIG / "scenarios" / f"max100-{name}.yaml")


@pytest.fixture
def noise_free(scenario: Callable[[str], Scenario]) -> Callable[[str], Scenario]:
    return lambda name: scenario(name).model_copy(update={"measurement": Measurement()})


@pytest.fixture
def sweep() -> Callable[..., SweepRun]:
    """A sweep of `axis` with the arm at (q2, q3); two periods unless said otherwise."""

    def make(
        axis: str,
        q2: float = 0.4,
        q3: float = -0.9,
        sample_rate: float = 1000.0,
        offset: float = 0.0105,
        periods: int = 2,
    ) -> SweepRun:
        return SweepRun(
            axis=axis,
            pose=(0.1, q2, q3, 0.0, 0.0, 0.0),
            offset_velocity=offset,
            sines=tuple((f, abs(offset) * 0.2, 0.5 * f * f) for f in (2.0, 3.0, 4.0, 5.0)),
            period=1.0,
            periods=periods,
            ramp=0.5,
            settle=1.0,
            sample_rate=sample_rate,
        )

    return make


@pytest.fixture
def dictionary() -> ObjectDictionary:
    """Node 3, motor of 20 N m and 3000 rev/min, limits at +-100 rev."""
    d = ObjectDictionary(EDS, 3)
    d[0x6076, 0] = 20_000
    for index in (0x607F, 0x6080):
        d[index, 0] = 3_000_000
    d[0x6081, 0] = 600_000
    d[0x607D, 1], d[0x607D, 2] = -100 << 20, 100 << 20
    return d


@pytest.fixture
def axis(dictionary: ObjectDictionary) -> VirtualAxis:
    return VirtualAxis(dictionary, CYCLE, can_move=True)


@pytest.fixture
def turn(axis: VirtualAxis) -> Callable[..., np.ndarray]:
    """Let the motor run `cycles` in chunks; the speeds, rev/s."""

    def run(cycles: int, chunk: int = 8, *, torque: float = 0.0, limited: bool = False) -> np.ndarray:
        speeds = []
        for _ in range(cycles // chunk):
            injected = axis.measuring.injection(chunk)
            command = axis.setpoints(chunk)
            position = axis.position + np.cumsum(command) * CYCLE
            axis.observe(
                DriveSamples(
                    torque=torque + injected,
                    torque_limited=np.full(chunk, limited),
                    command=command,
                    speed=command,
                    position=position,
                    load=np.full(chunk, np.nan),
                    injected=injected,
                )
            )
            speeds.append(command)
        return np.concatenate(speeds)

    return run


@pytest.fixture
def enable(dictionary: ObjectDictionary, axis: VirtualAxis) -> Callable[[int], None]:
    """Into OPERATION ENABLED in a mode of operation."""

    def go(mode: int) -> None:
        dictionary.download(0x6060, 0, bytes([mode]))
        for controlword in (0x06, 0x07, 0x0F):
            axis.control(controlword)

    return go
