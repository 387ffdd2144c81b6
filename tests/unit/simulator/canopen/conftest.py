"""A dictionary as the cabinet fills it, and an axis on a motor that follows its set-points exactly."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from simulator.canopen.axis import Axis
from simulator.canopen.dictionary import Dictionary
from simulator.canopen.measuring import Samples

EDS = Path(__file__).parents[4] / "config/eds/virtual-axis.eds"
CYCLE = 0.001


@pytest.fixture
def dictionary() -> Dictionary:
    """Node 3, motor of 20 N m and 3000 rev/min, limits at +-100 rev."""
    d = Dictionary(EDS, 3)
    d[0x6076, 0] = 20_000
    for index in (0x607F, 0x6080):
        d[index, 0] = 3_000_000
    d[0x6081, 0] = 600_000
    d[0x607D, 1], d[0x607D, 2] = -100 << 20, 100 << 20
    return d


@pytest.fixture
def axis(dictionary: Dictionary) -> Axis:
    return Axis(dictionary, CYCLE, can_move=True)


@pytest.fixture
def turn(axis: Axis) -> Callable[..., np.ndarray]:
    """Let the motor run `cycles` in chunks; the speeds, rev/s."""

    def run(cycles: int, chunk: int = 8, *, torque: float = 0.0, limited: bool = False) -> np.ndarray:
        speeds = []
        for _ in range(cycles // chunk):
            command = axis.setpoints(chunk)
            position = axis.position + np.cumsum(command) * CYCLE
            axis.observe(
                Samples(
                    torque=np.full(chunk, torque),
                    torque_limited=np.full(chunk, limited),
                    command=command,
                    speed=command,
                    position=position,
                    load=np.full(chunk, np.nan),
                )
            )
            speeds.append(command)
        return np.concatenate(speeds)

    return run


@pytest.fixture
def enable(dictionary: Dictionary, axis: Axis) -> Callable[[int], None]:
    """Into OPERATION ENABLED in a mode of operation."""

    def go(mode: int) -> None:
        dictionary.download(0x6060, 0, bytes([mode]))
        for controlword in (0x06, 0x07, 0x0F):
            axis.control(controlword)

    return go
