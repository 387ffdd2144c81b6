"""The shipped scenarios, and how to take effects out of them; a dictionary, and an axis that follows exactly."""

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simulator import Measurement, Scenario, SweepRun, load_scenario
from simulator.drive.dictionary import ObjectDictionary
from simulator.drive.limits import INCREMENTS
from simulator.drive.measuring import DriveSamples
from simulator.drive.power_drive import DriveState
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


class Rig:
    """A virtual drive whose motor follows exactly."""

    def __init__(self, dictionary: ObjectDictionary) -> None:
        self.dictionary = dictionary
        self.axis = VirtualAxis(dictionary, CYCLE, can_move=True)

    @property
    def state(self) -> DriveState:
        return self.axis.state

    def held(self, index: int, subindex: int = 0) -> Any:
        return self.dictionary[index, subindex]

    def control(self, *controlwords: int) -> None:
        for controlword in controlwords:
            self.axis.control(controlword)

    def enable(self, mode: int) -> None:
        """Into OPERATION ENABLED in a mode of operation."""
        self.dictionary.download(0x6060, 0, bytes([mode]))
        self.control(0x06, 0x07, 0x0F)

    def move(self, revolutions: float) -> None:
        self.dictionary[0x607A, 0] = round(revolutions * INCREMENTS)
        self.control(0x0F, 0x1F)

    def stream(self, speed: float, now: float) -> None:
        """A set-point in rev/s and the SYNC after it."""
        self.dictionary.download(0x60FF, 0, struct.pack("<i", round(speed * self.axis.limits.speed_unit)))
        self.axis.sync(now)

    def turn(self, cycles: int, chunk: int = 8, *, torque: float = 0.0, limited: bool = False) -> np.ndarray:
        """Let the motor run `cycles` in chunks; the speeds, rev/s."""
        speeds = []
        for _ in range(cycles // chunk):
            injected = self.axis.measuring.injection(chunk)
            command = self.axis.setpoints(chunk)
            samples = DriveSamples(
                torque=torque + injected,
                torque_limited=np.full(chunk, limited),
                command=command,
                speed=command,
                position=self.axis.position + np.cumsum(command) * CYCLE,
                load=np.full(chunk, np.nan),
                injected=injected,
            )
            self.axis.observe(samples)
            speeds.append(command)
        return np.concatenate(speeds)


@pytest.fixture
def rig(dictionary: ObjectDictionary) -> Rig:
    return Rig(dictionary)
