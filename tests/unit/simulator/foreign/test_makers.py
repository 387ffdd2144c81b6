"""Four real drives' dictionaries, from ../shared/data/drives (skipped where that is absent), behind one machine.

What is measured with the `canopen` package as master is held against what the machine really does, in units computed
here from the makers' documents.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import pytest

from simulator.canopen.node import Nmt
from tests.foreign_bench import MAKERS, Foreign, bench
from tests.unit.simulator.foreign.conftest import RIGID
from tests.unit.simulator.foreign.master import ENABLE, PERIOD, QUICK_STOP, Cycle, Master

pytestmark = pytest.mark.slow

GEAR, RATED = 171, 17.544  # of joint 1; N m of the motor
AMPERES = 10.0  # at rated torque, of every motor here
VELOCITY, POSITION, INTERPOLATED = 0x60FF0000, 0x607A0000, 0x60C10100
STATE, VALUE, READ_ONLY, NO_OBJECT = 0x08000022, 0x06090030, 0x06010002, 0x06020000
DRIVE, GO_ON = ENABLE, ENABLE | 0x10  # bit 4: interpolation active


@dataclass(frozen=True)
class Way:
    """A mode that a host may stream in."""

    maker: str
    mode: int
    target: int
    word: int = DRIVE

    def __str__(self) -> str:
        return f"{self.maker}-{self.mode}"


WAYS = [
    Way("epos4", 9, VELOCITY),
    Way("epos4", 8, POSITION),
    Way("epos4", 3, VELOCITY),
    Way("gold", 9, VELOCITY),
    Way("gold", 8, POSITION),
    Way("gold", 7, INTERPOLATED, GO_ON),
    Way("simpliq", 3, VELOCITY),
    Way("simpliq", 7, INTERPOLATED, GO_ON),
    Way("powerball", 7, INTERPOLATED, GO_ON),
]
# In a revolution of the motor, and in a revolution a second of it
POSITION_UNITS = {"epos4": 3200.0, "gold": 65536.0, "simpliq": 8192.0, "powerball": 360_000 / GEAR}
VELOCITY_UNITS = POSITION_UNITS | {"epos4": 60.0}


@pytest.fixture(scope="module", params=list(MAKERS))
def foreign(request: pytest.FixtureRequest) -> Iterator[Foreign]:
    """One cabinet of a maker's drives for all of its tests."""
    with bench(request.param, scenario=RIGID) as foreign:
        yield foreign


def only(*makers: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("foreign", makers, indirect=True, scope="module")


@pytest.mark.parametrize(
    ("foreign", "way"), [(way.maker, way) for way in WAYS], indirect=["foreign"], ids=str, scope="module"
)
def test_a_streamed_velocity_turns_the_axis_and_the_torque_is_the_true_one(master: Master, way: Way) -> None:
    speed = 1.5  # rev/s of the motor
    position, velocity = POSITION_UNITS[way.maker], VELOCITY_UNITS[way.maker]
    cycle = Cycle(master, way.target)
    master.write(0x6060, 0, way.mode, 1)
    assert master.number(0x6061) == way.mode
    here = cycle.run(0, 0, 1)[3]
    step = speed * position * PERIOD * 1e-3
    target = round(speed * velocity) if way.target == VELOCITY else lambda k: round(here + step * k)
    cycle.enable(0 if way.target == VELOCITY else here)
    cycle.run(way.word, target, 250)
    truth = master.truth()
    last = target if isinstance(target, int) else target(250)
    word, told, permille, place = cycle.run(way.word, last, 1)
    assert word & 0x6F == 0x27
    assert told == pytest.approx(speed * velocity, rel=0.05, abs=1)
    assert truth["velocity"] == pytest.approx(speed * math.tau / GEAR, rel=0.05)
    assert truth["position"] == pytest.approx(place / position * math.tau / GEAR, abs=2e-3)
    assert permille * 1e-3 * RATED * GEAR == pytest.approx(truth["effort"], abs=0.6e-3 * RATED * GEAR)
    assert abs(truth["effort"]) > 100.0
    cycle.run(QUICK_STOP, last, 1)
    master.settle(lambda: abs(master.truth()["velocity"]) < 1e-5)


def test_the_package_walks_the_states_with_the_pdos_of_the_file(master: Master) -> None:
    node = master.node
    master.network.sync.start(0.02)
    try:
        node.setup_402_state_machine()
        node.nmt.state = "OPERATIONAL"
        for state in ("READY TO SWITCH ON", "SWITCHED ON", "OPERATION ENABLED", "SWITCH ON DISABLED"):
            node.state = state
        assert not master.truth()["energised"]
    finally:
        master.network.sync.stop()


def test_every_readable_object_of_the_file_is_there_and_no_other(master: Master) -> None:
    objects = master.node.object_dictionary
    for entry in objects.values():
        for variable in [entry] if not hasattr(entry, "values") else entry.values():
            if variable.index >= 0x1000 and variable.readable and variable.data_type not in (9, 10, 15):
                assert 8 * len(master.read(variable.index, variable.subindex)) == len(variable)
    for index in (0x60FF, 0x6072, 0x6076, 0x6080, 0x603F, 0x605A, 0x6007, 0x60A9, 0x1029, 0x1402, 0x1803):
        if index not in objects:
            master.refused(NO_OBJECT, index, 0, 0, 4)


@only("epos4")
def test_a_finer_unit_of_velocity_is_that_of_the_limits_too(master: Master) -> None:
    """Numbers stay: what was rev/min in 6080h is 10^-3 of it now, and stops nearly all motion until it is written."""
    fast = master.number(0x6080)
    master.refused(VALUE, 0x60A9, 0, 0x00B50300, 4)
    master.write(0x60A9, 0, 0xFDB44700, 4)
    assert master.number(0x6080) == fast
    cycle = master.enabled(9, VELOCITY)
    assert cycle.run(ENABLE, 90_000, 20)[0] & 0x0800
    master.write(0x6080, 0, 1000 * fast, 4)
    assert cycle.run(ENABLE, 90_000, 250)[1] == pytest.approx(90_000, rel=0.02)
    assert master.truth()["velocity"] == pytest.approx(1.5 * math.tau / GEAR, rel=0.02)


@only("epos4")
def test_pdos_are_configured_in_pre_operational_alone(master: Master) -> None:
    master.node.nmt.state = "OPERATIONAL"
    master.refused(STATE, 0x1800, 2, 1, 1)
    master.refused(STATE, 0x1803, 1, 1 << 31 | 0x481, 4)


@pytest.mark.parametrize(
    ("foreign", "missing"),
    [("epos4", (7,)), ("gold", (2,)), ("simpliq", (2, 8, 9))],
    indirect=["foreign"],
    scope="module",
)
def test_a_mode_that_the_drive_does_not_have_is_refused(master: Master, missing: tuple[int, ...]) -> None:
    master.write(0x6060, 0, 3, 1)
    for mode in missing:
        master.refused(VALUE, 0x6060, 0, mode, 1)
    assert master.number(0x6061) == 3


@only("powerball")
def test_a_drive_without_a_velocity_mode_does_not_show_one(master: Master) -> None:
    master.write(0x6060, 0, 7, 1)
    for mode in (3, 8, 9):
        master.write(0x6060, 0, mode, 1)
        assert master.number(0x6061) == 7
    assert master.number(0x6075) == AMPERES * 1000


@only("powerball")
def test_a_position_far_from_where_the_axis_stands_is_a_fault(master: Master) -> None:
    cycle = Cycle(master, INTERPOLATED)
    master.write(0x6060, 0, 7, 1)
    here = cycle.run(0, 0, 1)[3]
    cycle.enable(here)
    cycle.run(GO_ON, here + 60_000, 20)
    master.settle(lambda: 0x8611 in master.emergencies)
    master.settle(lambda: not master.truth()["energised"])
    assert master.truth()["position"] < math.radians((here + 30_000) * 1e-3)


@only("powerball")
def test_interpolation_waits_for_its_bit(master: Master) -> None:
    cycle = Cycle(master, INTERPOLATED)
    master.write(0x6060, 0, 7, 1)
    here = cycle.run(0, 0, 1)[3]
    cycle.enable(here)
    word, _, _, place = cycle.run(ENABLE, here + 500, 50)
    assert not word & 0x1000
    assert place == pytest.approx(here, abs=5)


@only("simpliq")
def test_identifiers_that_nobody_may_write(master: Master) -> None:
    master.refused(READ_ONLY, 0x1400, 1, 1 << 31 | 0x201, 4)
    master.write(0x1A00, 0, 0, 1)
    master.write(0x1A00, 1, 0x60640020, 4)
    master.write(0x1A00, 0, 1, 1)
    master.refused(0x06090031, 0x1600, 0, 3, 1)


@only("gold")
def test_a_host_can_be_watched_though_the_file_limits_the_object_to_the_time(master: Master) -> None:
    master.write(0x1016, 1, 127 << 16 | 300, 4)
    master.enabled(9, VELOCITY)
    master.network.send_message(0x77F, bytes([Nmt.OPERATIONAL]))
    master.settle(lambda: 0x8130 in master.emergencies)
    master.settle(lambda: not master.truth()["energised"])
    assert master.truth()["nmt"] == "operational"  # its 1029h says: no change


@only("gold")
def test_position_units_follow_the_feed_constant(master: Master) -> None:
    before = master.number(0x607D, 2)
    assert before == pytest.approx(2.96 * GEAR / math.tau * 65536, abs=1)
    master.write(0x608F, 1, 65536, 4)
    master.write(0x6092, 1, 360, 4)
    cycle = Cycle(master, POSITION)
    here = cycle.run(0, 0, 1)[3]
    assert here == pytest.approx(master.truth()["position"] * GEAR / math.tau * 360, abs=1)
    for sub, end in enumerate((here - 720, here + 720), 1):
        master.write(0x607D, sub, end, 4)
    master.write(0x6060, 0, 8, 1)
    cycle.enable(here)
    cycle.run(ENABLE, lambda k: here + k, 91)
    cycle.run(ENABLE, here + 90, 200)
    assert master.truth()["position"] == pytest.approx((here + 90) / 360 * math.tau / GEAR, abs=1e-3)


@only("epos4", "gold")
def test_an_offset_of_torque_pushes_the_axis(master: Master) -> None:
    """A tenth of rated torque, more than friction, beside a speed controller that holds against it."""
    cycle = master.enabled(9, 0x60B20000)
    before = cycle.run(ENABLE, 0, 20)[2]
    pushed = [cycle.run(ENABLE, 100, 1)[2] for _ in range(3)]
    assert max(pushed) > before + 50
    assert master.truth()["velocity"] > 0
