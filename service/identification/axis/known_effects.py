r"""Known effects of a robot in addition to its rigid body: named by a diagnosis and accepted by a user.

The document is that of a model revision, or of `sweepid diagnose --model`: by joint the effects with their
parameters (value, std, unit) and, if present, their covariance in the same order, and whether torques are as
recorded or true. A value that is not a number is rejected. Effects with other names, or without a required parameter,
are not used; the estimate lists them (`axis_document.used_effects`).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from service.model.errors import BadInput
from service.model.results.effect import Effect
from service.model.results.revision import KnownModel, ModelSource

Array = NDArray[np.float64]

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
