"""What a sweep's channels may not say of one another."""

import dataclasses

import numpy as np
import pytest

from service.machine.execution.sweep_samples import ImplausibleChannels, check_channels
from service.model import Recording, Sine, SweepSpec

RATE = 250.0
SPEC = SweepSpec(
    id="0001",
    axis="joint_1",
    pose=(0.0,),
    offset_velocity=0.0105,
    sines=(Sine(frequency=2.0, amplitude=0.002), Sine(frequency=5.0, amplitude=0.002, phase=1.0)),
    period=1.0,
    periods=5,
    measure_from=1.0,
    sample_rate=RATE,
)
STILL = SPEC.model_copy(update={"offset_velocity": 0.0})


def measured(spec: SweepSpec = SPEC, late: float = 0.0, seed: int = 1) -> Recording:
    """A load of 200 kg m^2 behind a motor, with noise; velocity `late` s behind the encoder."""
    rng = np.random.default_rng(seed)
    time = np.arange(round(6.5 * RATE)) / RATE
    velocity, position = np.full(len(time), spec.offset_velocity), spec.offset_velocity * time
    acceleration = np.zeros(len(time))
    for sine in spec.sines:
        w = 2 * np.pi * sine.frequency
        angle = w * (time - spec.measure_from) + sine.phase
        velocity += sine.amplitude * np.sin(angle - w * late)
        position -= sine.amplitude / w * np.cos(angle)
        acceleration += w * sine.amplitude * np.cos(angle)
    return Recording(
        time=time,
        effort=200 * acceleration + 150 * velocity + rng.normal(0, 6.0, len(time)),
        velocity=velocity + rng.normal(0, 5e-6, len(time)),
        position=position + rng.normal(0, 2e-8, len(time)),
        load_position=position * 1.01 + rng.normal(0, 1e-7, len(time)),
    )


def changed(recording: Recording, **columns: np.ndarray) -> Recording:
    return dataclasses.replace(recording, **columns)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("spec", [SPEC, STILL], ids=["turning", "about standstill"])
def test_noise_is_no_reason(spec: SweepSpec, seed: int) -> None:
    check_channels(spec, measured(spec, seed=seed))


def test_about_standstill_little_is_asked() -> None:
    """Nothing without sines. Presliding: effort follows the way, as a spring's, and takes a little energy; or the axis
    is held by its friction.
    """
    column, recording = np.zeros(1600), measured(STILL)
    still = Recording(time=np.arange(1600) / RATE, effort=column, velocity=column, position=column)
    check_channels(STILL.model_copy(update={"sines": ()}), still)
    sprung = 4e5 * (recording.position - recording.position.mean()) + 400 * recording.velocity
    check_channels(STILL, changed(recording, effort=recording.effort + sprung))
    with pytest.raises(ImplausibleChannels, match="below 0"):
        check_channels(SPEC, changed(GOOD, effort=GOOD.effort + 4e5 * recording.position))
    stuck = changed(recording, velocity=0.01 * recording.velocity, position=0.01 * recording.position)
    check_channels(STILL, stuck)
    with pytest.raises(ImplausibleChannels, match="position"):
        check_channels(STILL, changed(stuck, velocity=recording.velocity))


def test_a_slow_channel_and_coarse_units_are_no_reason() -> None:
    """Speed in whole rev/min, cut off; torque in per mille; an encoder of 4096 steps a revolution of the motor."""
    check_channels(SPEC, measured(late=5e-3))
    recording = measured()
    turn = 2 * np.pi / 171
    speed, step = turn / 60, turn / 4096
    check_channels(
        SPEC,
        changed(
            recording,
            velocity=np.floor(recording.velocity / speed) * speed,
            position=np.floor(recording.position / step) * step,
            effort=np.round(recording.effort / 3.0) * 3.0,
        ),
    )


def frozen(values: np.ndarray, duration: float) -> np.ndarray:
    values = values.copy()
    values[600 : 601 + round(duration * RATE)] = values[600]
    return values


def jump(values: np.ndarray, by: float, samples: int | None = None) -> np.ndarray:
    values = values.copy()
    values[800 : None if samples is None else 800 + samples] += by
    return values


GOOD = measured()
assert GOOD.load_position is not None
BROKEN = {
    "effort frozen": ({"effort": frozen(GOOD.effort, 0.3)}, "effort stands still for 0.3 s .* limit 0.25 s"),
    "effort never changes": ({"effort": np.zeros_like(GOOD.time)}, "effort stands still for 5 s"),
    "velocity frozen": ({"velocity": frozen(GOOD.velocity, 0.3)}, "velocity stands still"),
    "position frozen": ({"position": frozen(GOOD.position, 0.3)}, "position stands still"),
    "load frozen": ({"load_position": frozen(GOOD.load_position, 0.3)}, "load position stands still"),
    "one sample of position": ({"position": jump(GOOD.position, 1e-3, 1)}, "position jumps .* at sample 550 "),
    "position steps": ({"position": jump(GOOD.position, 2e-4)}, "position jumps"),
    "load steps": ({"load_position": jump(GOOD.load_position, 2e-4)}, "load position jumps"),
    "encoder and speed": (
        {"position": jump(GOOD.position, 1e-4), "velocity": jump(GOOD.velocity, 0.0125, 2), "load_position": None},
        "velocity jumps",
    ),
    "velocity's unit": (
        {"velocity": GOOD.velocity * 1.02},
        r"position changes by 0.98\d* times the integral of velocity",
    ),
    "velocity's sign": ({"velocity": -GOOD.velocity}, "position changes by -1"),
    "load's unit": ({"load_position": GOOD.position * 1.06}, "direct encoder moves 1.06 times as far"),
    "load's sign": ({"load_position": -GOOD.load_position}, "direct encoder|load position jumps"),
    "effort's sign": ({"effort": -GOOD.effort}, r"apparent inertia -\d+.* at 2 Hz is below 0"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_contradictions_are_found_and_told(case: str) -> None:
    columns, message = BROKEN[case]
    with pytest.raises(ImplausibleChannels, match=f"^joint_1: .*{message}"):
        check_channels(SPEC, changed(GOOD, **columns))


def test_signs_are_found_without_an_offset() -> None:
    recording = measured(STILL)
    with pytest.raises(ImplausibleChannels, match="position changes by -1"):
        check_channels(STILL, changed(recording, velocity=-recording.velocity))
    with pytest.raises(ImplausibleChannels, match="below 0"):
        check_channels(STILL, changed(recording, effort=-recording.effort))
