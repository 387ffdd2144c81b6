"""What is said of the machine's state is never better than the truth, whatever is reported, lost, frozen or late."""

import math
from dataclasses import dataclass, field

import pytest
from hypothesis import given, strategies as st

from drivers.ports import AxisState, AxisStatus
from service.machine.execution.statement import Condition, Reports

JOINTS = ("joint_1", "joint_2")
TICK = 1e-3  # s between two events: neither happens at the same time as the other
SILENT = AxisStatus("", AxisState.UNKNOWN, math.nan, math.nan, math.nan, None)


@dataclass
class Truth:
    """Two axes, the clock, and what was true of each axis at each time."""

    now: float = 0.0
    axes: dict[str, tuple[bool, bool]] = field(default_factory=lambda: dict.fromkeys(JOINTS, (False, False)))
    past: list[tuple[float, dict[str, tuple[bool, bool]]]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.change({})

    def change(self, axes: dict[str, tuple[bool, bool]]) -> None:
        self.axes = self.axes | axes
        self.past.append((self.now, self.axes))

    def at(self, time: float) -> dict[str, tuple[bool, bool]]:
        return next(axes for since, axes in reversed(self.past) if since <= time + TICK / 10)


def status(joint: str, moves: bool, energised: bool) -> AxisStatus:
    state = AxisState.ENABLED if energised else AxisState.DISABLED
    return AxisStatus(joint, state, 0.0, 0.1 if moves else 0.0, 0.0, None, not moves, energised)


EVENTS = st.one_of(
    st.tuples(st.just("time"), st.floats(0.001, 3.0)),
    st.tuples(st.just("truth"), st.sampled_from(JOINTS), st.booleans(), st.booleans()),
    st.tuples(st.just("report"), st.sampled_from([(), ("joint_1",), ("joint_2",), JOINTS])),
    st.tuples(st.just("late report"), st.floats(0.0, 3.0)),
    st.tuples(st.just("lost")),
    st.tuples(st.just("connected")),
    st.tuples(st.just("enable"), st.sampled_from(JOINTS)),
    st.tuples(st.just("disable"), st.sampled_from(JOINTS)),
)


@given(st.lists(EVENTS, max_size=30))
def test_it_is_never_better_than_the_truth(events: list[tuple]) -> None:
    truth = Truth()
    reports = Reports(JOINTS, lambda: truth.now)
    enabled: set[str] = set()
    for event in events:
        truth.now += TICK
        match event:
            case ("time", passed):
                truth.now += passed
            case ("truth", joint, moves, energised):
                truth.change({joint: (moves, energised or joint in enabled)})
            case ("report", silent):
                answers = {joint: status(joint, *truth.axes[joint]) for joint in JOINTS}
                reports.note({joint: SILENT if joint in silent else answers[joint] for joint in JOINTS}, truth.now)
            case ("late report", took):  # what the drives said when they were asked, known only now
                reports.note({joint: status(joint, *truth.axes[joint]) for joint in JOINTS}, truth.now)
                truth.now += took
            case ("lost",):
                reports.lost("the bus is off")
            case ("connected",):
                reports.connected()
            case ("enable", joint):
                enabled.add(joint)
                reports.gets_energy([joint])
                truth.change({joint: (truth.axes[joint][0], True)})
            case ("disable", joint) if joint in enabled:
                enabled.discard(joint)
                truth.change({joint: (truth.axes[joint][0], False)})
                reports.gave_energy_up([joint])
            case _:
                pass
        said = reports.statement
        for joint, axis in said.axes.items():
            if axis.state is Condition.UNKNOWN:
                assert axis.reason
                continue
            assert axis.age is not None
            assert axis.age <= Reports.stale
            moved, energised = truth.at(truth.now - axis.age)[joint]
            assert axis.state is Condition.MOVES or not moved
            assert axis.state is not Condition.STANDS or not energised
            assert axis.state is not Condition.STANDS or joint not in enabled  # energised by this service by now
        states = {axis.state for axis in said.axes.values()}
        assert said.state is min(states, key=list(Condition).index)
        if said.state is Condition.UNKNOWN:
            assert said.reason


@pytest.mark.parametrize(
    ("state", "told", "age", "said", "reason"),
    [
        (AxisState.DISABLED, (True, False), 1.0, Condition.STANDS, ""),
        (AxisState.DISABLED, (True, True), 1.0, Condition.ENERGISED, ""),  # switched on: no torque, but energy
        (AxisState.DISABLED, (False, False), 1.0, Condition.MOVES, ""),  # turns without energy
        (AxisState.FAULT, (False, False), 1.0, Condition.MOVES, ""),
        (AxisState.FAULT, (True, True), 1.0, Condition.ENERGISED, ""),
        (AxisState.UNKNOWN, (True, False), 1.0, Condition.UNKNOWN, ""),  # a statusword that has no meaning
        (AxisState.DISABLED, (), 0.0, Condition.MOVES, ""),  # an adapter that tells neither standstill nor energy
        (AxisState.DISABLED, (True, False), Reports.stale, Condition.STANDS, ""),
        (
            AxisState.DISABLED,
            (True, False),
            Reports.stale + 0.1,
            Condition.UNKNOWN,
            "the last report is 2.1 s old, limit 2 s",
        ),
    ],
)
def test_what_a_drive_reports_is_said(
    state: AxisState, told: tuple[bool, ...], age: float, said: Condition, reason: str
) -> None:
    reports = Reports(["joint_1"], lambda: age)
    reports.connected()
    reports.note({"joint_1": AxisStatus("joint_1", state, 0.0, 0.0, 0.0, None, *told)}, 0.0)
    assert reports.statement.state is said
    assert reason in (reports.statement.reason or "")
