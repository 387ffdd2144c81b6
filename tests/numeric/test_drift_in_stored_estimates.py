"""A robot that drifts by 1 % is found through the stored estimates of eight virtual robots over twelve months.

All is set before the run: plants, drift, probability. The plants are simulated, identified and stored by the real code;
each month is judged with what is stored by then.
"""

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from service.identification.estimation import estimate_document, sweep_spectrum
from service.identification.fleet.document import FleetType
from service.identification.fleet.survey import FleetRules
from service.model import Robot, Sweep, build_robot
from service.planning.campaigns.stored_results import FleetHistory
from service.store import tables as t
from service.store.database import Database, open_database
from service.store.documents import NewRecording, NewSweep, RecordingState, SpectrumRecord, SweepState
from service.store.plant import FleetStore
from service.store.store import Store
from simulator import Scenario
from tests.numeric.campaign import max100, measure_at, scenario_named

pytestmark = pytest.mark.slow

ROBOTS, MONTHS, POSES = 8, 12, 6
AXES = ("joint_2", "joint_3")
DRIFTING, AXIS, DRIFT = 4, "joint_2", 0.01  # of J, from the sixth month on
BEFORE = 5  # months
RULES = FleetRules(probability=0.01, campaigns=MONTHS, remeasure_days=31)
START = datetime(2026, 1, 5, tzinfo=UTC)


def month(number: int) -> datetime:
    return START + timedelta(days=30 * number)


def plant(number: int, drifted: bool) -> Scenario:
    """Robots of one type differ by a few percent of a link. The drift: torque of a drive per ampere."""
    scenario = scenario_named("max100-full")
    factors = np.random.default_rng(500 + number).normal(1.0, 0.02, 2)
    links = {
        name: scenario.links[name].model_copy(update={"mass": scenario.links[name].mass * float(factor)})
        for name, factor in zip(("link_2", "link_3"), factors, strict=True)
    }
    axes = dict(scenario.axes)
    if drifted:
        train = axes[AXIS].train.model_copy(update={"effort_gain": 1 + DRIFT})
        axes[AXIS] = axes[AXIS].model_copy(update={"train": train})
    return scenario.model_copy(update={"links": {**scenario.links, **links}, "axes": axes})


def campaigns_of(number: int) -> list[tuple[Sweep, ...]]:
    """The sweeps of each month, simulated together: noise and friction differ from sweep to sweep."""
    poses = np.zeros((POSES, 6))
    poses[:, 1], poses[:, 2] = np.linspace(-1, 1, POSES), np.linspace(1, -1.5, POSES)
    found: list[tuple[Sweep, ...]] = []
    parts = ((False, BEFORE), (True, MONTHS - BEFORE)) if number == DRIFTING else ((False, MONTHS),)
    for drifted, months in parts:
        scenario, seed = plant(number, drifted), 10 * number + drifted
        sweeps = measure_at(scenario, seed, np.tile(poses, (months, 1)), 250.0, axes=AXES).sweeps
        by_axis = np.array(sweeps, dtype=object).reshape(len(AXES), months, POSES)
        found += [tuple(by_axis[:, k].ravel()) for k in range(months)]
    return found


def numbered(number: int) -> Robot:
    robot = max100()
    return build_robot(robot.description.model_copy(update={"serial": f"R{number}"}), robot.urdf_text)


def stored(database: Database, robot: Robot, sweeps: Sequence[Sweep], at: datetime) -> None:
    """A campaign with the estimate of all its sweeps, as its last job stores it."""
    store = Store(database)
    specs = [NewSweep(spec=one.spec, mode=None) for one in sweeps]
    recordings = [
        NewRecording(state=RecordingState.COMPLETE, path=f"{at:%m}/{one.spec.id}", sha256="0" * 64, samples=1)
        for one in sweeps
    ]
    campaign = store.add_measured(store.add_robot(robot).id, specs, recordings)
    document = estimate_document(robot, [sweep_spectrum(robot, one) for one in sweeps]).as_json()
    spectrum = SpectrumRecord(path="spectrum", sha256="0" * 64)
    last = store.sweep(campaign.id, len(sweeps))
    assert store.add_estimate([(last, spectrum)], lambda _: SweepState.IDENTIFIED, document) is not None
    with database.write() as session:
        session.get_one(t.CampaignRow, campaign.id).started_at = at


@pytest.fixture(scope="module")
def judged(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[FleetType]]:
    """The fleet as it stood after each month."""
    folder: Path = tmp_path_factory.mktemp("plant")
    robots = [(numbered(number), campaigns_of(number)) for number in range(ROBOTS)]
    with open_database(f"sqlite:///{folder / 'plant.sqlite'}", machine="cell 1") as database:
        history = FleetHistory(FleetStore(database))
        found: list[FleetType] = []
        for number in range(MONTHS):
            for robot, campaigns in robots:
                stored(database, robot, campaigns[number], month(number))
            (one,) = history.fleet(RULES, month(number) + timedelta(days=1)).types
            found.append(one)
        yield found


def test_the_drift_is_found_and_the_other_seven_are_quiet(judged: list[FleetType]) -> None:
    alarms = [{one.serial for one in month.robots if one.changed} for month in judged]
    assert set().union(*alarms) == {f"R{DRIFTING}"}
    assert not any(alarms[:BEFORE])
    first = next(number for number, found in enumerate(alarms, 1) if found)
    last = judged[-1]
    print(f"found after month {first}; std between campaigns {last.between_percent} %")
    assert first <= BEFORE + 4
    (robot,) = (one for one in last.robots if one.changed)
    assert robot.changed == (AXIS,)
    change = robot.axes[AXIS].change
    assert change is not None
    assert change.change_percent == pytest.approx(100 * DRIFT, abs=3 * change.std_percent)
    assert change.since == robot.axes[AXIS].points[BEFORE].campaign


def test_each_robot_has_its_series_and_none_is_due(judged: list[FleetType]) -> None:
    last = judged[-1]
    assert [one.serial for one in last.robots] == [f"R{number}" for number in range(ROBOTS)]
    assert {len(axis.points) for one in last.robots for axis in one.axes.values()} == {MONTHS}
    assert not any(one.due for one in last.robots)
    assert not any(one.outlier for one in last.robots)  # they differ among themselves by more
