"""Bundles of any shape end in a result or in one BadInput, whatever is done with them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import sweepid
from service import BadInput
from service.data_check import check, findings_document
from service.model import Recording, Robot, Sweep
from service.store.files.bundle import Bundle, read_bundle, write_bundle
from service.store.files.columns import write_columns
from tests.unit.service.data_check.conftest import OFFSET, RATED, lift_sweep, pair

pytestmark = pytest.mark.slow

USES: dict[str, Callable[[Bundle], object]] = {
    "check": lambda bundle: findings_document(
        bundle.robot, bundle.sweeps, check(bundle.robot, bundle.sweeps)
    ).as_json(),
    "identify": lambda bundle: sweepid.identify(bundle).as_json(),
    "diagnose": lambda bundle: sweepid.diagnose(bundle, twin=False).as_json(),
    "diagnose with its twin": lambda bundle: sweepid.diagnose(bundle).as_json(),
}

CHANGES: dict[str, Callable[[Recording], Recording]] = {
    "32 bits": lambda r: _each(r, lambda values: values.astype(np.float32).astype(np.float64)),
    "8 bits": lambda r: _each(r, lambda values: np.round(values / (span := np.ptp(values) or 1) * 255) / 255 * span),
    "8 bits of rated": lambda r: replace(r, effort=np.round(r.effort * 127 / RATED) * RATED / 127),
    "reversed": lambda r: replace(r, effort=-r.effort),
    "N mm": lambda r: replace(r, effort=1000 * r.effort),
    "no effort": lambda r: replace(r, effort=np.zeros_like(r.effort)),
    "no velocity": lambda r: replace(r, velocity=np.zeros_like(r.velocity)),
    "stands": lambda r: replace(r, velocity=0 * r.velocity, position=np.full_like(r.position, r.position[0])),
    "clipped": lambda r: replace(r, effort=np.minimum(r.effort, np.quantile(r.effort, 0.7))),
    "huge": lambda r: replace(r, effort=1e12 * r.effort),
    "encoder beside": lambda r: replace(r, load_position=r.position.copy(), load_velocity=r.velocity.copy()),
}


def _each(record: Recording, change: Callable[[np.ndarray], np.ndarray]) -> Recording:
    return replace(record, **{name: change(getattr(record, name)) for name in ("effort", "velocity", "position")})


@st.composite
def shapes(draw: st.DrawFn) -> tuple[Sweep, ...]:
    """One to four sweeps of an axis, each with a length, a rate, a direction and a record of its own."""
    sweeps: list[Sweep] = []
    directions = draw(st.sampled_from([(1,), (1, 1), (1, -1), (1, 1, -1, -1), (0, 0), (1, 0)]))
    rates = draw(st.sampled_from([(40.0,), (100.0,), (250.0,), (1000.0,), (40.0, 1000.0)]))
    elsewhere = draw(st.sampled_from([None, None, 0.3]))
    changes = draw(st.lists(st.sampled_from(sorted(CHANGES)), max_size=2, unique=True))
    free = draw(st.sampled_from(["lines", "lines", "lines", "trajectory", "standstill", "noise"]))
    for number, direction in enumerate(directions):
        periods, rate = draw(st.integers(1, 4)), draw(st.sampled_from(rates))
        run_up = draw(st.sampled_from([0.0, 0.5]))
        sweep = lift_sweep(number, direction * OFFSET, repeat=number % 2, periods=periods, rate=rate, run_up=run_up)
        record = sweep.recording
        for name in changes:
            record = CHANGES[name](record)
        spec = sweep.spec
        if elsewhere is not None and number > 1:
            spec = spec.model_copy(update={"pose": (spec.pose[0], elsewhere)})
        if free != "lines":
            update = {"excitation": free, "sines": (), "period": None, "periods": None}
            spec = spec.model_copy(update=update)
        sweeps.append(Sweep(spec, record))
    return tuple(sweeps)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("use", sorted(USES))
@settings(max_examples=60, deadline=None, derandomize=True)
@given(sweeps=shapes(), suffix=st.sampled_from(["parquet", "csv", None]))
def test_a_bundle_of_any_shape_ends_in_a_result_or_in_bad_input(
    use: str, sweeps: tuple[Sweep, ...], suffix: str | None
) -> None:
    robot = pair()
    with TemporaryDirectory() as folder:
        try:
            bundle = (
                Bundle(robot, sweeps) if suffix is None else _by_file(Path(folder) / "bundle", robot, sweeps, suffix)
            )
            result = USES[use](bundle)
        except BadInput as refused:
            result = {refused.place: refused.reason}
    assert isinstance(result, dict)
    assert result


def _by_file(folder: Path, robot: Robot, sweeps: tuple[Sweep, ...], suffix: str) -> Bundle:
    write_bundle(folder, robot, sweeps)
    if suffix == "csv":
        text = (folder / "bundle.json").read_text()
        (folder / "bundle.json").write_text(text.replace(".parquet", ".csv"))
        for number, sweep in enumerate(sweeps, 1):
            write_columns(folder / f"sweeps/{number:04}.csv", sweep.recording)
    return read_bundle(folder)
