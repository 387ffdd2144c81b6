r"""Known effects of a robot in addition to its rigid body: named by a diagnosis and accepted by a user.

The document is that of a model revision, or of `sweepid diagnose --model`: by joint the effects with their
parameters (value, std, unit) and, if present, their covariance in the same order, and whether torques are as
recorded or true. A value that is not a number is rejected. Effects with other names, or without a required parameter,
are not used; the estimate lists them (`document.used_effects`).

Their effort is removed from the spectrum of a sweep (`corrected`).

Delay. The effort of an instant arrives `delay` later than the motion of that instant:  E -> E e^{s delay}.

Friction of a known law f(v), and the torque of a hose if no gravity row contains it:  E -> E - DFT[f(v)]. The motion of
the motor is the measured one: v(t) follows from its bins and the offset, which is the mean,

    v_n = v0 + 2 Re sum_b V_b e^{2 pi i f_b n / rate},    q_n - q_0 = v0 t_n + 2 Re sum_b V_b / s_b e^{...}

(content above these bins is noise, which changes the law only in second order). Nothing
but the spectrum is needed, so sweeps recorded before the effect was accepted are corrected as well.

Each known parameter has a standard deviation. Each independent change of the parameters by one of them (`directions`)
changes the spectrum by one column; its amount is a parameter of the joint fit shared by all sweeps, 0 +- 1.

Laws as in the catalogue of the diagnosis:  coulomb sign(v);  + coulomb_difference |sign(v)| + viscous_difference |v|;
(coulomb + extra exp(-|v/velocity|^exponent)) sign(v);  coefficient x (1 + x^2)^((exponent - 1)/2), x = v/velocity;
(coulomb + load_dependence (sqrt(Ts^2 + T1^2) - T1) + load_curvature Ts^2/T1) sign(v), T1 the knee, with the gear's
torque Ts = gravity + J_l dv_l/dt. The last is known only if
gravity is so much larger than the rest that Ts keeps its sign. Otherwise it depends on load friction and CAD errors,
J has the additional uncertainty load_dependence J_l, and nothing is removed.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from service import BadInput
from service.identification.axis.drive_train import TwoMassTrain, impedance
from service.identification.spectra.frequency_response import Spectrum
from service.model import Array, Complex
from service.model.results.effect import Effect, KnownModel, ModelSource

DELAY = "measurement_delay"
ELASTICITY = "joint_elasticity"
HOSE = "hose_spring"
GAIN = "torque_constant_error"
LOAD = "load_dependent_friction"
NEEDED = {  # required parameters of each effect
    DELAY: ("delay",),
    ELASTICITY: ("compliance", "damping_time"),
    HOSE: ("stiffness",),
    GAIN: ("gain_error",),
    LOAD: ("coulomb", "load_dependence"),
    "coulomb_friction": ("coulomb",),
    "asymmetric_friction": ("coulomb", "coulomb_difference", "viscous_difference"),
    "stribeck_friction": ("coulomb", "extra", "velocity", "exponent"),
    "nonlinear_viscous_friction": ("coefficient", "exponent"),
}
POSITIVE = {ELASTICITY: ("compliance", "damping_time", "ratio"), "stribeck_friction": ("velocity",)}


@dataclass(frozen=True)
class KnownEffect:
    """One effect of an axis: its parameters by name, their covariance (p, p) in that order, and their units."""

    name: str
    values: Mapping[str, float]
    covariance: Array
    units: Mapping[str, str]

    @property
    def std(self) -> dict[str, float]:
        return dict(zip(self.values, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def unusable(self) -> str:
        """Why the effect cannot be used, or ""."""
        missing = [name for name in NEEDED.get(self.name, ()) if name not in self.values]
        wrong = [name for name in POSITIVE.get(self.name, ()) if not self.values.get(name, 1.0) > 0]
        if self.name == GAIN and not missing and not self.values["gain_error"] > -1:
            wrong.append("1 + gain_error")
        if missing:
            return f"it has no parameter {', '.join(missing)}"
        return f"its {', '.join(wrong)} is not above 0" if wrong else ""

    def directions(self) -> list[dict[str, float]]:
        """Independent changes of the parameters by one standard deviation: the columns of a square root of the
        covariance.
        """
        variance, vectors = np.linalg.eigh(self.covariance / np.outer(self._scale, self._scale))
        root = self._scale[:, None] * vectors * np.sqrt(np.maximum(variance, 0.0))
        return [dict(zip(self.values, column.tolist(), strict=True)) for column in root.T]

    @property
    def _scale(self) -> Array:
        std = np.sqrt(np.diag(self.covariance))
        return np.where(std > 0, std, 1.0)


@dataclass(frozen=True)
class KnownAxis:
    """The effects of one axis. `true_torque`: parameters apply to true torques, otherwise to those reported by the
    drive.
    """

    effects: tuple[KnownEffect, ...] = ()
    true_torque: bool = False

    def get(self, name: str) -> KnownEffect | None:
        """The effect with this name, if it exists and can be used."""
        return next((effect for effect in self.effects if effect.name == name and not effect.unusable), None)


@dataclass(frozen=True)
class KnownEffects:
    """All axes by joint, and the model they come from; None if nothing is known."""

    axes: Mapping[str, KnownAxis] = field(default_factory=dict[str, KnownAxis])
    source: ModelSource | None = None

    def of(self, joint: str) -> KnownAxis:
        return self.axes.get(joint, KnownAxis())


def known_effects(model: KnownModel, joints: Sequence[str], source: ModelSource) -> KnownEffects:
    """The effects of a model. BadInput names joint, effect and parameter that cannot be used."""
    found: dict[str, KnownAxis] = {}
    for joint, axis in model.axes.items():
        place = f"model.axes.{joint}"
        if joint not in joints:
            raise BadInput(place, f"is not a joint of the robot; its joints are {', '.join(joints)}")
        effects = tuple(_effect(effect, f"{place}.effects.{effect.effect}") for effect in axis.effects)
        found[joint] = KnownAxis(effects, axis.fit.torques == "true")
    return KnownEffects(found, source)


def _effect(effect: Effect, place: str) -> KnownEffect:
    values: dict[str, float] = {}
    std: list[float] = []
    for name, one in effect.parameters.items():
        values[name] = _number(one.value, f"{place}.{name}.value")
        std.append(_number(one.std, f"{place}.{name}.std"))
        if std[-1] < 0:
            raise BadInput(f"{place}.{name}.std", f"{std[-1]} is below 0")
    units = {name: one.unit for name, one in effect.parameters.items()}
    return KnownEffect(
        effect.effect, values, _covariance(effect.covariance, np.array(std), f"{place}.covariance"), units
    )


def _covariance(stated: Sequence[Sequence[float]], std: Array, place: str) -> Array:
    """Built from the given standard deviations and the correlations of the covariance, if it has these parameters."""
    correlation = np.eye(len(std))
    if len({len(row) for row in stated}) > 1:
        raise BadInput(place, "has rows of different lengths")
    given = np.array(stated, dtype=np.float64)
    if given.size and given.shape == correlation.shape and np.all(np.isfinite(given)) and np.all(np.diag(given) > 0):
        scale = np.sqrt(np.diag(given))
        with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
            correlation = given / np.outer(scale, scale)
        # rounding of a singular one, or variances so small that their roots are none
        if not np.all(np.isfinite(correlation)) or np.linalg.eigvalsh(correlation)[0] < 0:
            correlation = np.eye(len(std))
    return correlation * np.outer(std, std)


def _number(value: float | None, place: str) -> float:
    if value is None or not math.isfinite(value):
        raise BadInput(place, f"{value} is not a finite number")
    return value


@dataclass(frozen=True)
class GearLoad:
    """Load of the gear in the pose of a sweep: inertia kg m^2 (kg), torque and stiffness of gravity.

    `train`: how it follows the motor; None: rigidly.
    """

    inertia: float
    gravity: float
    stiffness: float
    train: TwoMassTrain | None = None


@dataclass(frozen=True)
class SweepMotion:
    """Samples (n,) of a window: velocity, travel since its start, torque of the load's acceleration and of
    gravity; SI.
    """

    velocity: Array
    way: Array
    accelerating: Array
    holding: Array

    @property
    def transmitted(self) -> Array:
        """Torque through the gear."""
        return self.accelerating + self.holding


Law = Callable[[Mapping[str, float], SweepMotion], Array]

LAWS: dict[str, Law] = {
    "coulomb_friction": lambda p, m: p["coulomb"] * np.sign(m.velocity),
    "asymmetric_friction": lambda p, m: (
        p["coulomb"] * np.sign(m.velocity)
        + p["coulomb_difference"] * np.abs(np.sign(m.velocity))
        + p["viscous_difference"] * np.abs(m.velocity)
    ),
    "stribeck_friction": lambda p, m: (
        (p["coulomb"] + p["extra"] * np.exp(-(np.abs(m.velocity / p["velocity"]) ** p["exponent"])))
        * np.sign(m.velocity)
    ),
    "nonlinear_viscous_friction": lambda p, m: _nonlinear_viscous(p, m),
    LOAD: lambda p, m: _load_dependent(p, m),
}


def _nonlinear_viscous(p: Mapping[str, float], m: SweepMotion) -> Array:
    """Carreau's law; a model of an earlier version has a power of the speed, at a unit of 0.01 rad/s (m/s)."""
    if "velocity" not in p:
        return p["coefficient"] * np.sign(m.velocity) * np.abs(m.velocity / 0.01) ** p["exponent"]
    ratio = m.velocity / p["velocity"]
    return p["coefficient"] * ratio * (1 + ratio**2) ** ((p["exponent"] - 1) / 2)


def _load_dependent(p: Mapping[str, float], m: SweepMotion) -> Array:
    """A stored model of an earlier version has no knee."""
    knee = p.get("knee", 0.0)
    grows = p["load_dependence"] * (np.hypot(m.transmitted, knee) - knee)
    if knee > 0:
        grows = grows + p.get("load_curvature", 0.0) * m.transmitted**2 / knee
    return (p["coulomb"] + grows) * np.sign(m.velocity)


@dataclass(frozen=True)
class Corrected:
    """A spectrum without its known effects; `uncertain` (k, b): change of the effort by one standard deviation of each.

    `doubt`: one standard deviation of the inertia, kg m^2 (kg), for effects that could not be removed.
    """

    spectrum: Spectrum
    uncertain: Complex
    doubt: float = 0.0


def corrected(spectrum: Spectrum, known: KnownAxis, gain: float, load: GearLoad) -> Corrected:
    """Correct a sweep with lines whose effort is reported by the drive, `gain` times the true one.

    The effort of the result is true effort.
    """
    nudge = 1e-3  # of one standard deviation, for derivatives
    if not known.effects:
        nothing = np.zeros((0, len(spectrum.frequency)), dtype=np.complex128)
        return Corrected(replace(spectrum, effort=spectrum.effort / gain), nothing)
    s: Complex = np.multiply(2j * np.pi, spectrum.frequency, dtype=np.complex128)
    scale = 1.0 if known.true_torque else 1 / gain
    effort: Complex = spectrum.effort / gain
    columns: list[Complex] = []
    delay = known.get(DELAY)
    if delay is not None:
        effort = effort * np.exp(s * delay.values["delay"])
        columns.append(-delay.std["delay"] * s * effort)
    motion, doubt = motion_of(spectrum, load), 0.0
    for effect in known.effects:
        law = LAWS.get(effect.name)
        if law is None or effect.unusable:
            continue
        if effect.name == LOAD and not _keeps_its_sign(motion):
            doubt = abs(effect.values["load_dependence"]) * load.inertia
            columns += [np.zeros_like(s) for _ in effect.values]
            continue
        torque = law(effect.values, motion)
        effort = effort - scale * _dft(torque, spectrum)
        for step in effect.directions():
            moved = {name: value + nudge * step[name] for name, value in effect.values.items()}
            columns.append(scale * _dft((law(moved, motion) - torque) / nudge, spectrum))
    hose = known.get(HOSE)
    if hose is not None:
        pull: Complex = scale * _dft(motion.way, spectrum)
        columns.append(hose.std["stiffness"] * pull)
        if not len(spectrum.named("gravity_stiffness")):  # else it is part of k_g, on the right side of the spring
            effort = effort - hose.values["stiffness"] * pull
    uncertain = np.array(columns, dtype=np.complex128).reshape(len(columns), len(spectrum.frequency))
    return Corrected(replace(spectrum, effort=effort), uncertain, doubt)


def motion_of(spectrum: Spectrum, load: GearLoad) -> SweepMotion:
    """The motion of the motor over the measured window, from its bins."""
    count, rate = spectrum.samples, spectrum.spec.sample_rate
    number = np.round(spectrum.frequency * count / rate).astype(int)
    s: Complex = np.multiply(2j * np.pi, spectrum.frequency, dtype=np.complex128)

    def signal(bins: Complex) -> Array:
        whole = np.zeros(count // 2 + 1, dtype=np.complex128)
        whole[number] = bins * count
        return np.fft.irfft(whole, count)

    offset = spectrum.spec.offset_velocity
    follows = 1.0 if load.train is None else impedance(spectrum.frequency, load.train, load.inertia, 0.0).through
    sway = signal(spectrum.velocity / s)
    way = offset * np.arange(count) / rate + sway - sway[0]
    return SweepMotion(
        velocity=offset + signal(spectrum.velocity),
        way=way,
        accelerating=load.inertia * signal(s * follows * spectrum.velocity),
        holding=load.gravity * np.cos(way) + load.stiffness * np.sin(way),
    )


def _keeps_its_sign(motion: SweepMotion) -> bool:
    """Whether gravity decides the direction of the torque through the gear all along the window."""
    # all others are below half of gravity's torque
    return float(np.abs(motion.accelerating).max()) < 0.5 * float(np.abs(motion.holding).min())


def _dft(signal: Array, spectrum: Spectrum) -> Complex:
    """At the bins of a spectrum, (b,)."""
    number = np.round(spectrum.frequency * spectrum.samples / spectrum.spec.sample_rate).astype(int)
    transform: Complex = np.fft.rfft(signal)
    return transform[number] / len(signal)
