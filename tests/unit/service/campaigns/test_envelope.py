"""The safety envelope: every limit is felt, each message names axis, value, limit and unit."""

from dataclasses import replace
from math import inf, nan, pi, radians

import numpy as np
import pytest
from hypothesis import given, strategies as st

from drivers.ports import SampleBlock, SineCommand, SweepCommand, SweepMode
from service import EnvelopeViolation
from service.identification.estimates.torque_gain import KnownMass
from service.model import Robot
from service.model.configuration import Box, Cell
from service.planning.safety.envelope_check import Envelope, peak_acceleration, peak_velocity, travel_bounds
from tests.unit.service.campaigns.small_arm import small_arm

POSE = (-0.5, 0.3)
COMMAND = SweepCommand(
    joint="j1",
    mode=SweepMode.DRIVE_SIDE,
    offset_velocity=0.012,
    sines=(SineCommand(2.0, 0.003, 0.1), SineCommand(5.0, 0.003, 2.0)),
    period=1.0,
    periods=3,
    ramp=0.5,
    settle=0.5,
    sample_rate=250.0,
    velocity_limit=0.1,
    effort_limit=2000.0,
    position_window=(-0.505, -0.445),
)


@pytest.fixture
def arm() -> Robot:
    return small_arm()


@pytest.fixture
def envelope(arm: Robot) -> Envelope:
    return Envelope(arm, Cell(name="test", floor=0.0, joint_margin=0.02))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": "j9"}, "j9: robot arm has j1, j2"),
        ({"offset_velocity": 0.03}, r"j1: travel .* rad is above the limit 0.06981 rad"),
        ({"offset_velocity": nan}, "not finite"),
        ({"periods": 200}, "duration 201.5 s is above the limit 120 s"),
        ({"periods": 0}, "0 periods"),
        ({"ramp": 0.0}, "ramp of the sweep is 0.0"),
        ({"sample_rate": inf}, "sample rate of the sweep is inf"),
        ({"position_window": (-0.505, -0.47)}, "highest position of the sweep -0.45133 rad is outside"),
        ({"position_window": (-2.0, 1.0)}, "lower end of the position window -2 rad is outside"),
        ({"velocity_limit": 0.015}, "peak velocity 0.018 rad/s is above the limit 0.015 rad/s"),
        ({"velocity_limit": 0.5}, "velocity limit 0.5 rad/s is above the limit 0.1 rad/s"),
        ({"effort_limit": 400.0}, r"predicted peak effort .* N m is above the limit 400 N m"),
        ({"effort_limit": 5000.0}, "effort limit 5000 N m is above the limit 2000 N m"),
    ],
)
def test_each_limit_of_a_sweep(envelope: Envelope, change: dict[str, object], message: str) -> None:
    envelope.check_sweep(COMMAND, POSE)
    with pytest.raises(EnvelopeViolation, match=message):
        envelope.check_sweep(replace(COMMAND, **change), POSE)


def test_joint_limits_hold_for_the_whole_travel(envelope: Envelope) -> None:
    near = 1.6 - 0.02 - 0.03  # 0.048 rad of travel do not fit below the joint's limit and the cell's margin
    command = replace(COMMAND, position_window=(near - 0.005, near + 0.055))
    with pytest.raises(EnvelopeViolation, match="upper end of the position window"):
        envelope.check_sweep(command, (near, -2.0))


def test_an_obstacle_inside_the_travel_is_found(arm: Robot) -> None:
    # the tool's centre passes 2 m from the shoulder; the box lies just beyond the end of the travel
    angle = -0.45
    box = Box(name="b", center=(2.0 * np.cos(angle), 0, 1.0 - 2.0 * np.sin(angle) - 0.21), size=(0.02, 0.02, 0.02))
    blocked = Envelope(arm, Cell(name="test", boxes=(box,), clearance=0.05))
    straight = (POSE[0], 0.0)
    assert blocked.checker.collision_free(np.array([straight]))[0]
    with pytest.raises(EnvelopeViolation, match=r"j1: the sweep's window .* is not free: clearance under 0.05 m"):
        blocked.check_sweep(COMMAND, straight)


@pytest.mark.parametrize(
    ("pose", "target", "velocity", "message"),
    [
        (POSE, 1.59, 0.1, r"target 1.59 rad is outside -2.98 to 1.58 rad"),
        (POSE, -1.5, 2.0, r"velocity of the move 2 rad/s is above the limit 0.5 rad/s"),
        (POSE, 1.0, 0.1, r"the path from -0.5000 to 1.0000 rad is not free"),  # into the floor
        ((0.0,), 1.0, 0.1, "pose has 1 positions"),
    ],
)
def test_each_limit_of_a_move(
    envelope: Envelope, pose: tuple[float, ...], target: float, velocity: float, message: str
) -> None:
    envelope.check_move("j1", POSE, -1.5, 0.1)
    with pytest.raises(EnvelopeViolation, match=message):
        envelope.check_move("j1", pose, target, velocity)


BLOCK = SampleBlock(
    joint="j1",
    index=np.arange(2),
    time=np.arange(2) / 250.0,
    effort=np.array([500.0, 510.0]),
    velocity=np.array([0.01, 0.011]),
    position=np.array([-0.49, -0.48]),
    velocity_setpoint=np.zeros(2),
)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": np.array([-0.49, -0.40])}, "j1: position -0.4 rad is outside -0.505 to -0.445 rad"),
        ({"velocity": np.array([-0.2, 0.0])}, "j1: velocity -0.2 rad/s is outside -0.1 to 0.1 rad/s"),
        ({"effort": np.array([500.0, 2100.0])}, "j1: effort 2100 N m is outside -2000 to 2000 N m"),
        ({"effort": np.array([500.0, nan])}, "j1: effort nan N m"),
        ({"load_position": np.array([-0.49, -0.3])}, "j1: load position -0.3 rad"),
        ({"joint": "j2"}, "j2: moves although j1"),
    ],
)
def test_each_limit_of_the_samples(envelope: Envelope, change: dict[str, object], message: str) -> None:
    envelope.watch(COMMAND, BLOCK)
    with pytest.raises(EnvelopeViolation, match=message):
        envelope.watch(COMMAND, replace(BLOCK, **change))


def test_order_of_legs_goes_round_an_obstacle(arm: Robot) -> None:
    # the straight swing of j1 hits a post in front; with the forearm folded first it passes
    post = Box(name="post", center=(1.9, 0.0, 1.0), size=(0.1, 0.1, 0.1))
    cell = Cell(name="test", boxes=(post,), home={"j2": -2.0})
    legs = Envelope(arm, cell).order_of_legs((-0.8, 0.0), (0.8, 0.0))
    assert len(legs) > 1
    pose = np.array([-0.8, 0.0])
    for joint, target in legs:
        assert Envelope(arm, cell).checker.leg_free(pose, joint, target)
        pose[joint] = target
    assert pose.tolist() == [0.8, 0.0]


amplitudes = st.floats(0.0, 0.02)
sines = st.lists(st.builds(SineCommand, st.floats(0.5, 20.0), amplitudes, st.floats(0, 2 * pi)), max_size=4)


@given(st.floats(-0.05, 0.05), sines, st.floats(0.1, 2.0), st.floats(0.0, 1.0))
def test_bounds_hold_at_every_instant(offset: float, lines: list[SineCommand], ramp: float, settle: float) -> None:
    command = replace(COMMAND, offset_velocity=offset, sines=tuple(lines), ramp=ramp, settle=settle)
    time = np.linspace(0.0, command.duration, 20_001)
    step = time[1]
    shape = np.clip(np.minimum(time, command.duration - time) / ramp, 0, 1)
    velocity = np.full_like(time, offset)
    for sine in lines:
        velocity += sine.amplitude * np.sin(2 * pi * sine.frequency * (time - command.measure_from) + sine.phase)
    velocity *= (1 - np.cos(pi * shape)) / 2
    position = np.concatenate([[0.0], np.cumsum((velocity[1:] + velocity[:-1]) / 2) * step])
    low, high = travel_bounds(command)
    assert low - 1e-6 <= position.min() <= position.max() <= high + 1e-6
    assert np.abs(velocity).max() <= peak_velocity(command) + 1e-12
    assert np.abs(np.diff(velocity)).max() / step <= peak_acceleration(command) * (1 + 1e-6) + 1e-9


def test_predicted_effort_by_hand_and_that_of_a_test_mass(arm: Robot) -> None:
    """20 kg at 0.6 m on the horizontal forearm: 20 * 9.81 * 0.6 more to hold, 20 * 0.36 kg m^2 more to accelerate."""
    command = replace(COMMAND, joint="j2", sines=(), offset_velocity=0.01, position_window=(0.29, 0.36))
    bare, loaded = (
        Envelope(arm, Cell(name="test"), None, mass).predicted_effort(command, (-0.325, 0.3))
        for mass in (None, KnownMass(20.0, (0.6, 0.0, 0.0)))
    )
    # forearm: 10 kg at 0.5 m, 1 kg m^2 about its centre; motor 100^2 * 0.001; both at the ramp's steepest
    inertia = 1.6 * (1.0 + 10 * 0.25) + 10.0
    gravity = 1.3 * 10 * 9.81 * 0.5  # horizontal inside the window when j1 + j2 = 0
    friction = 1.5 * 20.0 * 0.01
    steepest = 0.01 * pi / (2 * 0.5)
    assert bare == pytest.approx(inertia * steepest + gravity + friction + 0.1 * 400.0, rel=1e-4)
    assert loaded - bare == pytest.approx(1.3 * 20 * 9.81 * 0.6 + 1.6 * 20 * 0.36 * steepest, rel=1e-4)


def test_travel_limit_is_the_papers() -> None:
    low, high = travel_bounds(replace(COMMAND, sines=(), offset_velocity=radians(1.0)))
    assert high - low == pytest.approx(radians(4.0))
