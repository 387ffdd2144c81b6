r"""The drive train of one axis in the frequency domain, and the paper's formula for comparison.

Effort over motor velocity of two masses and a spring, friction on both sides, all on the joint side, s = i omega
(compliance form, so that a stiff train is simply c = 0):

    Z = s Jm + mu_m + Z_l F,   Z_l = s J_l + mu_l + k_g / s,   F = 1 / (1 + Y Z_l),   Y = s c / (1 + s h)

c = 1/k compliance [rad/(N m)], h = d/k time constant of the damping [s], k_g gravity stiffness [N m/rad]. F is also
the motor torque per torque on the load. Well below the locked-rotor frequency  Im Z / omega  tends to
Jm + J_l, the axis inertia.

The paper's equation (8) assumes a rigid train and uses |Im Z| at one line: `paper_inertia`.

The model of every bin of every sweep of an axis: the equations of the joint fit, as arrays over sweeps.

Bin by bin (`frequency_response`), for sweep p,

    DFT[effort] = Z Omega + F (G0 R0 + k_g R1 + t0 + s t1) + sum of ripple and dry friction + noise
    R0 = DFT[cos d],   R1 = DFT[sin d] - Omega / s

G0 and k_g are gravity's torque and stiffness at the start pose; Z already contains the linear, periodic part of k_g, R1
the rest (the travel at the offset leaks onto every line). t0, t1 are the transient of the load: over a window
that does not start at rest a rational system leaves a polynomial over the same denominator (Pintelon and Schoukens
2012, sec. 6.3).

If a direct encoder measures the motion Omega_l of the load, no spring is needed for it, and

    DFT[effort] = s (Jm Omega + J_l Omega_l) + mu_m Omega + mu_l Omega_l + G0 R0 + k_g (R1 + Omega_l / s) + t0 + ...

replaces it, linear in every parameter and independent of the spring; t0 is then the contribution of the difference of
the speeds at both ends of the window to the accelerations. Shared by all sweeps: Jm, mu_m, mu_l, c, h. Own to each:
J_l, k_g, G0, t0, t1, and one factor for each ripple and for the sign of a velocity that reverses.

The uncertainty of known effects (`known_effects`) adds x_1 U_1 + x_2 U_2 + ..., with the x shared by all sweeps.

Spring and damping of a drive train from its direct encoder, after the inertias are known without them.

The spring transmits the torque of the load, so at every line, with E = Omega - Omega_l,

    E (1 + s h) = s c T,    T = s J_l Omega_l + mu_l Omega_l + G0 R0 + k_g (R1 + Omega_l / s) + t0

which is linear in c and h. T has the errors of the load's inertia and friction, which the sweeps share: they are added
to the covariance. A fit of sweeps with and without the encoder takes c and h so found as a prior (`joint_fit`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from service.identification.spectra.frequency_response import Spectrum
from service.model import Array, Complex, Indices, Mask


@dataclass(frozen=True, slots=True)
class TwoMassTrain:
    """Parameters shared by all poses of an axis; SI on the joint side. Order of `as_array` and of all derivatives."""

    motor_inertia: float  # kg m^2 (kg), reflected
    motor_friction: float  # N m s/rad (N s/m)
    load_friction: float
    compliance: float  # rad/(N m) (m/N)
    damping_time: float  # s

    @classmethod
    def of(cls, values: Array) -> "TwoMassTrain":
        """From the first five of `values`."""
        return cls(*(float(value) for value in values[:SHARED]))

    def as_array(self) -> Array:
        return np.array(
            [self.motor_inertia, self.motor_friction, self.load_friction, self.compliance, self.damping_time]
        )

    def locked_rotor_frequency(self, load_inertia: float) -> float:
        """1/(2 pi) sqrt(k / J_l), Hz; inf for a stiff train, or if noise makes J_l zero or negative."""
        if self.compliance <= 0 or load_inertia <= 0:
            return float("inf")
        return float(1 / np.sqrt(self.compliance * load_inertia) / (2 * np.pi))


@dataclass(frozen=True, slots=True)
class Impedance:
    """Z and F at some frequencies (..., b), with the terms needed for their derivatives."""

    s: Complex
    load: Complex  # Z_l
    spring: Complex  # Y
    through: Complex  # F
    total: Complex  # Z

    def by_load(self, velocity: Complex, on_load: Complex) -> Complex:
        """d(Z velocity + F on_load) / d Z_l, (..., b)."""
        return self.through**2 * (velocity - self.spring * on_load)

    def by_spring(self, velocity: Complex, on_load: Complex) -> Complex:
        """d(Z velocity + F on_load) / d Y, (..., b)."""
        return -(self.through**2) * self.load * (self.load * velocity + on_load)


def impedance(
    frequency: Array, train: TwoMassTrain, load_inertia: float | Array, gravity_stiffness: float | Array
) -> Impedance:
    """The two-mass impedance at `frequency` (..., b), Hz; the load parameters broadcast against it."""
    s: Complex = np.multiply(2j * np.pi, frequency, dtype=np.complex128)
    load = s * load_inertia + train.load_friction + gravity_stiffness / s
    spring = s * train.compliance / (1 + s * train.damping_time)
    through = 1 / (1 + spring * load)
    return Impedance(s, load, spring, through, s * train.motor_inertia + train.motor_friction + load * through)


def paper_inertia(frequency: float, response: complex) -> float:
    """Equation (8) of the paper from the response Z = Gamma/Omega at `frequency`, Hz: kg m^2 (kg)."""
    phase = np.angle(1 / response)
    return float(abs(response) / (2 * np.pi * frequency) / np.sqrt(1 + 1 / np.tan(phase) ** 2))


SHARED = 5  # parameters of DriveTrain; the amounts x follow
OWN = 5  # J_l, k_g, G0, t0, t1; the factors of the direct terms follow


@dataclass(frozen=True)
class Stack:
    """n sweeps with the same number of bins b and direct terms r; `place` (n,): their index in the original list."""

    place: Indices
    s: Complex  # (n, b), i omega
    line: Mask  # (n, b)
    effort: Complex  # (n, b)
    velocity: Complex  # (n, b)
    load_velocity: Complex | None  # (n, b), direct encoder
    gravity_torque: Complex  # (n, b), R0
    gravity_rest: Complex  # (n, b), R1
    terms: Complex  # (n, r, b), torques on the motor: ripple, dry friction
    uncertain: Complex  # (n, u, b), U: uncertainty of known effects
    spread: Array  # (n, b), standard deviation of a bin relative to the noise
    samples: Array  # (n,)

    @property
    def shape(self) -> tuple[int, int, bool]:
        """Bins, direct terms, and whether the motion of the load is measured: equal for the sweeps of one stack."""
        return self.s.shape[1], self.terms.shape[1], self.load_velocity is not None

    def and_more(self, other: "Stack") -> "Stack":
        """With the sweeps of another one of the same shape."""
        pairs = {each.name: (getattr(self, each.name), getattr(other, each.name)) for each in fields(self)}
        return replace(self, **{name: np.concatenate(pair) for name, pair in pairs.items() if pair[0] is not None})

    @property
    def parameters(self) -> int:
        """Number of own parameters of each sweep."""
        return OWN + self.terms.shape[1]

    @property
    def frequency(self) -> Array:
        """(n, b) Hz."""
        return self.s.imag / (2 * np.pi)

    @property
    def largest(self) -> Array:
        """(n,) largest effort bin."""
        return np.abs(self.effort).max(axis=1)


def stacks(
    spectra: Sequence[Spectrum], uncertain: Sequence[Complex] | None = None, spread: Sequence[Array] | None = None
) -> tuple[Stack, ...]:
    """All spectra, grouped by shape; for each `uncertain` (u, b), with the same u for all, and `spread` (b,)."""
    known = list(uncertain or [np.zeros((0, len(one.frequency)), dtype=np.complex128) for one in spectra])
    wide = list(spread or [np.ones(len(one.frequency)) for one in spectra])
    groups: dict[tuple[int, int, bool], list[int]] = {}
    for place, one in enumerate(spectra):
        key = (len(one.frequency), len(direct_terms(one)), one.load_velocity is not None)
        groups.setdefault(key, []).append(place)
    return tuple(
        _stack(
            [spectra[place] for place in places],
            [known[place] for place in places],
            [wide[place] for place in places],
            places,
        )
        for places in groups.values()
    )


def direct_terms(spectrum: Spectrum) -> Complex:
    """Regressors of torques on the motor, (r, b): ripple, dry friction that reverses or holds the axis."""
    return np.concatenate([spectrum.named(name) for name in ("ripple", "coulomb", "rest")])


def _stack(
    spectra: Sequence[Spectrum], uncertain: Sequence[Complex], spread: Sequence[Array], places: Sequence[int]
) -> Stack:
    s = np.stack([np.multiply(2j * np.pi, one.frequency, dtype=np.complex128) for one in spectra])
    velocity = np.stack([one.velocity for one in spectra])
    load = [one.load_velocity for one in spectra if one.load_velocity is not None]
    gravity = [(one.named("gravity_torque"), one.named("gravity_stiffness")) for one in spectra]
    nothing = np.zeros_like(s[0])
    torque = np.stack([rows[0] if len(rows) else nothing for rows, _ in gravity])
    rest = [rows[0] - v / w if len(rows) else nothing for (_, rows), v, w in zip(gravity, velocity, s, strict=True)]
    return Stack(
        place=np.array(places),
        s=s,
        line=np.stack([one.line for one in spectra]),
        effort=np.stack([one.effort for one in spectra]),
        velocity=velocity,
        load_velocity=np.stack(load) if load else None,
        gravity_torque=torque,
        gravity_rest=np.stack(rest),
        terms=np.stack([direct_terms(one) for one in spectra]),
        uncertain=np.stack(uncertain),
        spread=np.stack(spread),
        samples=np.array([float(one.samples) for one in spectra]),
    )


def stack_residual(stack: Stack, shared: Array, own: Array) -> tuple[Complex, Complex, Complex]:
    """Unexplained effort (n, b); derivatives of the explained effort by shared (n, 5 + u, b) and own (n, OWN + r, b)
    parameters.

    `shared` (5 + u,) as in `TwoMassTrain.as_array` and the amounts x, `own` (n, OWN + r).
    """
    by_own = np.empty((len(own), stack.parameters, stack.s.shape[1]), dtype=np.complex128)
    by_own[:, OWN:] = stack.terms
    by_shared = np.zeros((len(own), len(shared), stack.s.shape[1]), dtype=np.complex128)
    by_shared[:, SHARED:] = stack.uncertain
    fill = _elastic if stack.load_velocity is None else _direct
    model = fill(stack, shared[:SHARED], own, by_shared, by_own)
    if stack.uncertain.shape[1]:
        model += np.einsum("u,nub->nb", shared[SHARED:], stack.uncertain)
    if stack.terms.shape[1]:
        model += np.einsum("nr,nrb->nb", own[:, OWN:], stack.terms)
    return stack.effort - model, by_shared, by_own


def _elastic(stack: Stack, shared: Array, own: Array, by_shared: Complex, by_own: Complex) -> Complex:
    train = TwoMassTrain.of(shared)
    compliance, damping_time = train.compliance, train.damping_time
    load, stiffness, torque, swing, swing_rate = (own[:, k, None] for k in range(OWN))
    z = impedance(stack.frequency, train, load, stiffness)
    s, velocity, rest = stack.s, stack.velocity, stack.gravity_rest
    on_load = torque * stack.gravity_torque + stiffness * rest + swing + s * swing_rate
    by_load, by_spring = z.by_load(velocity, on_load), z.by_spring(velocity, on_load)
    damped = 1 + s * damping_time
    by_shared[:, 0], by_shared[:, 1], by_shared[:, 2] = s * velocity, velocity, by_load
    by_shared[:, 3], by_shared[:, 4] = by_spring * s / damped, -by_spring * s**2 * compliance / damped**2
    by_own[:, 0], by_own[:, 1] = s * by_load, by_load / s + z.through * rest
    by_own[:, 2], by_own[:, 3], by_own[:, 4] = z.through * stack.gravity_torque, z.through, s * z.through
    return z.total * velocity + z.through * on_load


def _direct(stack: Stack, shared: Array, own: Array, by_shared: Complex, by_own: Complex) -> Complex:
    s, load_velocity = stack.s, stack.load_velocity
    if load_velocity is None:
        raise ValueError("the stack has no motion of the load")
    by_shared[:, 0], by_shared[:, 1], by_shared[:, 2] = s * stack.velocity, stack.velocity, load_velocity
    by_own[:, 0], by_own[:, 1] = s * load_velocity, stack.gravity_rest + load_velocity / s
    by_own[:, 2], by_own[:, 3], by_own[:, 4] = stack.gravity_torque, 1.0, 0.0
    return np.einsum("k,nkb->nb", shared[:3], by_shared[:, :3]) + np.einsum("nk,nkb->nb", own[:, :4], by_own[:, :4])


def effort_residual(spectrum: Spectrum, shared: Array, own: Array) -> tuple[Complex, Complex, Complex]:
    """`stack_residual` of one sweep: (b,), (b, 5), (b, OWN + r); `own` (OWN + r,)."""
    (stack,) = stacks([spectrum])
    residual, by_shared, by_own = stack_residual(stack, shared, own[None])
    return residual[0], by_shared[0].T, by_own[0].T


def spring(
    parts: Sequence[Stack], shared: Array, own: Sequence[Array], moves: Sequence[tuple[Array, Sequence[Array]]]
) -> tuple[Array, Array]:
    """Compliance and damping time [c, h] (2,) from stacks with a direct encoder, and their covariance (2, 2).

    `moves`: independent changes of one standard deviation, of the shared (5 + u,) and with them the own parameters.
    """
    values, covariance = _solve(parts, shared, own)
    for change, changes in moves:
        others = [one + by for one, by in zip(own, changes, strict=True)]
        moved = _solve(parts, shared + change, others)[0] - values
        covariance = covariance + np.outer(moved, moved)
    return values, covariance


def _solve(parts: Sequence[Stack], shared: Array, own: Sequence[Array]) -> tuple[Array, Array]:
    columns, values = zip(*(_rows(stack, shared, one) for stack, one in zip(parts, own, strict=True)), strict=True)
    rows, right = np.concatenate(columns), np.concatenate(values)
    scale = np.linalg.norm(rows, axis=0)
    solution = np.asarray(np.linalg.lstsq(rows / scale, right, rcond=None)[0], dtype=float)
    left = right - rows / scale @ solution
    variance = float(left @ left) / max(len(right) - 2, 1)
    gram = rows.T @ rows / np.outer(scale, scale)
    return solution / scale, variance * np.asarray(np.linalg.inv(gram), dtype=float) / np.outer(scale, scale)


def _rows(stack: Stack, shared: Array, own: Array) -> tuple[Array, Array]:
    """Rows (m, 2) and right sides (m,) of the lines of one stack."""
    _, by_shared, by_own = stack_residual(stack, shared, own)
    load_velocity = by_shared[:, 2]
    torque: Complex = shared[2] * load_velocity + np.einsum("nk,nkb->nb", own[:, :4], by_own[:, :4])
    twist = (stack.velocity - load_velocity)[stack.line]
    s = stack.s[stack.line]
    rows = np.stack([s * torque[stack.line], -s * twist], -1)
    return np.concatenate([rows.real, rows.imag]), np.concatenate([twist.real, twist.imag])
