r"""Designs one noise run: a slow motion with superposed pseudo-random torque (paper, section 4.1).

The paper's values are used: offset 0.1 rpm, 1 % of the rated torque, band below 40 Hz, softened speed control. Two
rules change them. The offset is the next lower one for which cogging does not fall on the lines (`ripple_free_offset`).
And a light axis must not reverse, because friction is constant only in one direction: noise of RMS f over n lines moves
a free inertia J by

    v_rms = f / (2 pi J sqrt(n)) sqrt(sum 1/f_k^2),

which may be `SWAY` of the offset. That is about the velocity in the softened loop with the resonance included;
random phases have peaks of 3 to 4 times their RMS.
"""

from dataclasses import dataclass
from math import ceil, floor

import numpy as np

from service.identification.design.excitation import ripple_free_offset
from service.model.errors import BadInput
from service.model.robot import Robot

OFFSET = 0.1 * 2 * np.pi / 60  # rad/s (m/s)
SHARE = 0.01  # of the rated effort
LOWEST, HIGHEST = 1.0, 39.0  # Hz
PERIOD, PERIODS = 1.6, 3  # s; prime by the cogging rule
RAMP, SETTLE = 0.5, 1.0  # s
SOFTENING = 0.4
SWAY = 0.2  # RMS of the noise's velocity over the offset


@dataclass(frozen=True, slots=True)
class NoiseExcitation:
    """One noise run from standstill to standstill; SI on the joint side, fields as in `drivers.ports.NoiseCommand`."""

    offset_velocity: float  # rad/s (m/s), signed
    effort: float  # N m (N), RMS
    lowest: float  # Hz
    highest: float  # Hz
    period: float  # s
    periods: int
    seed: int
    softening: float
    ramp: float  # s
    settle: float  # s

    @property
    def measure_from(self) -> float:
        """Start of the measured window, s."""
        return self.ramp + self.settle

    @property
    def duration(self) -> float:
        """From standstill to standstill, s."""
        return 2 * self.ramp + self.settle + self.periods * self.period

    @property
    def travel(self) -> float:
        """Signed travel from start to end, rad (m)."""
        return self.offset_velocity * (self.ramp + self.settle + self.periods * self.period)


def design_noise(
    robot: Robot, joint: str, *, inertia: float, travel: float, seed: int, direction: int = 1
) -> NoiseExcitation:
    """The noise run of a joint whose axis inertia is about `inertia`, kg m^2 (kg), within `travel` rad (m).

    Raises BadInput if cogging falls on its lines for every offset.
    """
    axis = robot.axis(joint)
    fastest = min(OFFSET, travel / (RAMP + SETTLE + PERIODS * PERIOD))
    offset = ripple_free_offset(axis, fastest, PERIOD, PERIODS)
    if offset <= 0:
        raise BadInput(joint, f"no offset up to {fastest:.4g} keeps the axis' cogging off the lines of its noise")
    lines = np.arange(ceil(LOWEST * PERIOD), floor(HIGHEST * PERIOD) + 1, dtype=np.float64) / PERIOD
    sway = float(np.sqrt(np.mean(1 / lines**2))) / (2 * np.pi * inertia)  # per N m
    effort = min(SHARE * axis.rated_effort, SWAY * offset / sway)
    return NoiseExcitation(direction * offset, effort, LOWEST, HIGHEST, PERIOD, PERIODS, seed, SOFTENING, RAMP, SETTLE)
