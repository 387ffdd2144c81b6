"""Units of a mapping against numbers worked out by hand, and what a mapping may not say."""

import math
from pathlib import Path
from typing import Any

import pytest
import yaml

from service import BadInput
from service.formats.traces.mapping import CncAxis, Mapping, SourceColumn, Unit
from service.model import Axis
from service.model.configuration import read_yaml

GEAR = Axis(joint="j", gear_ratio=-171.0, rated_effort=3000.0)
AXIS = CncAxis(name="A2", direction=-1, zero=90.0)


@pytest.mark.parametrize(
    ("unit", "source", "value"),
    [
        ("axis position", 30.0, math.radians(60.0)),  # 90 - 60
        ("deg", 30.0, math.radians(30.0)),
        ("mm", 30.0, 0.030),
        ("motor rev", 171.0, -2 * math.pi),
        ("motor rev/min", 171.0, -2 * math.pi / 60),
        ("motor N m", 2.0, -342.0),
        ("percent", 50.0, -1500.0),
        ("ms", 12.0, 0.012),
        ("samples", 5.0, 0.020),
    ],
)
def test_units(unit: Unit, source: float, value: float) -> None:
    scale, offset = SourceColumn(source="X", unit=unit).to_si(GEAR, AXIS, math.radians(1.0), 250.0)
    assert scale * source + offset == pytest.approx(value, rel=1e-12)


def test_a_linear_axis_is_in_mm() -> None:
    column = SourceColumn(source="X", unit="axis position")
    scale, offset = column.to_si(GEAR, CncAxis(name="X1", zero=5.0), 1e-3, 250.0)
    assert scale * 105.0 + offset == pytest.approx(0.1)


SWEEP = {"source": "t.csv", "id": "1", "axis": "j", "pose": [0.0], "offset_velocity": 0.01, "sample_rate": 250}
COLUMNS = {"effort": {"source": "T"}, "velocity": {"from_position": 100}, "position": {"source": "P"}}
PATH = {"path": {"ramp": 0.5, "settle": 0.5}}
WAVES = {"sines": [{"frequency": 2, "amplitude": 0.002}], "period": 1.0, "periods": 5}


@pytest.mark.parametrize(
    ("columns", "sweep", "reason"),
    [
        ({"position": {"source": "P", "unit": "deg", "scale": 2.0}}, {}, "columns.position: Value error, give a unit"),
        ({"position": {"source": "P", "unit": "grad"}}, {}, "columns.position.unit: Input should be 'axis position'"),
        ({}, PATH | WAVES, "Value error, a sweep with a path needs columns.set_position"),
        ({"set_position": {"source": "D"}}, PATH, "sweeps.0: Value error, path needs sines, period and periods"),
        ({}, {"path": {"ramp": 0, "settle": 0.5}}, "sweeps.0.path.ramp: Input should be greater than 0"),
    ],
)
def test_refusals(columns: dict[str, Any], sweep: dict[str, Any], reason: str, tmp_path: Path) -> None:
    path = tmp_path / "mapping.yaml"
    path.write_text(yaml.safe_dump({"robot": "r.yaml", "columns": COLUMNS | columns, "sweeps": [SWEEP | sweep]}))
    with pytest.raises(BadInput) as refusal:
        read_yaml(path, Mapping)
    assert reason in str(refusal.value)
