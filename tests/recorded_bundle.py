"""A bundle whose numbers use all bits of a float64, and a mapping that reads its export back."""

from pathlib import Path

import numpy as np
import yaml

from service.model import Recording, Sine, Sweep, SweepSpec
from service.model.configuration import read_robot
from service.store.files.bundle import Bundle

ROBOT = Path(__file__).resolve().parents[1] / "config/robots/max100-class.yaml"
COLUMNS = ("time", "effort", "velocity", "position", "velocity_setpoint", "temperature")


def recorded(*, rate: float, axis: str, number: int) -> Sweep:
    """One second of noise."""
    rng = np.random.default_rng(number)
    noise = {name: rng.normal(size=int(rate)) * 10.0 ** rng.integers(-9, 4) for name in COLUMNS[1:]}
    spec = SweepSpec(
        id=f"{axis} no. {number}",
        axis=axis,
        pose=(0.1, -0.9, 0.3, 0.0, 1 / 3, 0.0),
        offset_velocity=0.0105,
        sines=(Sine(frequency=2.0, amplitude=0.002, phase=0.3),),
        period=0.5,
        periods=2,
        sample_rate=rate,
        started_at=12.3 * number,
        repeat=number,
        block='"slow" & <größer>',
    )
    return Sweep(spec, Recording(time=np.arange(int(rate)) / rate, **noise))


def bundle() -> Bundle:
    """Two sweeps of two rates and axes."""
    sweeps = (recorded(rate=250.0, axis="joint_2", number=1), recorded(rate=1000.0, axis="joint_3", number=2))
    return Bundle(read_robot(ROBOT), sweeps)


def mapping(path: Path, source: str, groups: dict[str, str], columns: dict[str, object] | None = None) -> Path:
    """A mapping file that reads the sweeps of `bundle` from one file, each from a group of its own."""
    entries = [
        {**sweep.spec.model_dump(mode="json"), "source": source, "group": groups[sweep.spec.id]}
        for sweep in bundle().sweeps
        if sweep.spec.id in groups
    ]
    named = columns or {name: {"source": name} for name in COLUMNS}
    path.write_text(yaml.safe_dump({"robot": str(ROBOT), "columns": named, "sweeps": entries}), encoding="utf-8")
    return path
