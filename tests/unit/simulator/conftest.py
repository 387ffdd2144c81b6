"""The shipped scenarios, and how to take effects out of them."""

from collections.abc import Callable
from pathlib import Path

import pytest

from simulator import Measurement, Scenario, SweepRun, load_scenario

CONFIG = Path(__file__).parents[3] / "config"


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
