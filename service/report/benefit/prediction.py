r"""The effort that a rigid-body model predicts in a sweep, and the residual of the measured effort.

    effort(t) = sum over lines of Z Omega  +  G cos d + k sin d  +  mu v_mean  +  a + b sign(v)

Z = Z(J) is the drive train's impedance (`axis_inertia`) with the model's inertia J, Omega the measured velocity at the
line, d the measured distance from the start pose; G and k the model's gravity. Only J, G and k differ between models.
The drive train is the same for both models: spring, damping, rotor and viscous friction from the training sweeps,
because CAD contains none of these; mu is viscous friction on both sides of it. Dry friction a, b is fitted to the means
of the training sweeps for each model; it absorbs the constant part of its gravity error. So friction is no
disadvantage for either model, and they differ only in their rigid bodies. (A fitted factor of v_mean would
absorb more: if a plan selects speeds by pose, it looks like gravity.) All efforts are torques of the drive: an error
of the torque constant is the same in measured and identified effort.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.spectra.frequency_response import Spectrum, window
from service.model.recording import Sweep

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RigidBody:
    """The rigid-body model of an axis in a pose; SI units on the joint side."""

    inertia: float  # kg m^2 (kg)
    gravity_torque: float  # N m (N)
    gravity_stiffness: float  # N m/rad


@dataclass(frozen=True)
class Window:
    """The measured window of a sweep, arrays (n,); `bins` of its DFT are the excited lines, `speed` (b,) there."""

    effort: Array
    way: Array
    velocity: Array
    bins: NDArray[np.int_]
    frequency: Array  # (b,) Hz
    speed: NDArray[np.complex128]


def window_of(sweep: Sweep, spectrum: Spectrum, own: int) -> Window:
    """The window of a sweep with lines of joint number `own`; BadInput if its record is too short."""
    spec, record = sweep.spec, sweep.recording
    first, count = window(spec, record.time)
    part = slice(first, first + count)
    frequency = spectrum.frequency[spectrum.line]
    return Window(
        effort=record.effort[part],
        way=record.position[part] - spec.pose[own],
        velocity=record.velocity[part],
        bins=np.round(frequency * count / spec.sample_rate).astype(int),
        frequency=frequency,
        speed=spectrum.velocity[spectrum.line],
    )


def left_by(body: RigidBody, train: TwoMassTrain, measured: Window) -> Array:
    """Measured effort (n,) minus inertia, gravity, the drive train's part at the lines and its viscous friction."""
    count = len(measured.effort)
    lines = np.zeros(count // 2 + 1, dtype=np.complex128)
    z = impedance(measured.frequency, train, body.inertia - train.motor_inertia, 0.0)
    lines[measured.bins] = z.total * measured.speed
    swing = np.fft.irfft(lines, count) * count
    gravity = body.gravity_torque * np.cos(measured.way) + body.gravity_stiffness * np.sin(measured.way)
    viscous = (train.motor_friction + train.load_friction) * measured.velocity.mean()
    return np.asarray(measured.effort - swing - gravity - viscous, dtype=float)


def dry_friction(left: Sequence[Array], measured: Sequence[Window]) -> Array:
    """a and b of the module docstring: least squares over the means of `left` of each sweep, (2,).

    If the sweeps do not separate them (one direction), the shortest vector: its prediction is the same.
    """
    rows = np.array([_dry(one).mean(axis=0) for one in measured])
    return np.asarray(np.linalg.lstsq(rows, np.array([one.mean() for one in left]), rcond=None)[0], dtype=float)


def without_friction(left: Array, measured: Window, friction: Array) -> Array:
    """The residual (n,) after subtraction of dry friction."""
    return np.asarray(left - _dry(measured) @ friction, dtype=float)


def lines_power(signal: Array, measured: Window) -> float:
    """Mean square of the component of a signal (n,) at the excited lines."""
    amplitudes = np.fft.rfft(signal)[measured.bins] / len(signal)
    return 2 * float(np.sum(np.abs(amplitudes) ** 2))


def _dry(measured: Window) -> Array:
    return np.stack([np.ones_like(measured.velocity), np.sign(measured.velocity)], -1)
