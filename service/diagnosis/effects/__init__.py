"""The catalogue of effects; the order is that of explanation, simple things first."""

from service.diagnosis.effects import (
    asymmetric_friction,
    backlash,
    cogging_torque,
    coulomb_friction,
    effort_offset,
    friction_temperature_drift,
    gravity_error,
    hose_spring,
    joint_elasticity,
    load_dependent_friction,
    measurement_delay,
    nonlinear_viscous_friction,
    payload,
    presliding_hysteresis,
    stribeck_friction,
    torque_constant_error,
    transmission_error,
)
from service.diagnosis.effects.effect import Effect

_MODULES = (
    coulomb_friction,
    asymmetric_friction,
    stribeck_friction,
    nonlinear_viscous_friction,
    load_dependent_friction,
    friction_temperature_drift,
    gravity_error,
    hose_spring,
    joint_elasticity,
    measurement_delay,
    cogging_torque,
    transmission_error,
    presliding_hysteresis,
    backlash,
    effort_offset,
    torque_constant_error,
    payload,
)

CATALOGUE: dict[str, Effect] = {module.EFFECT.name: module.EFFECT for module in _MODULES}
"""All effects by name (DESIGN.md, "Effect names")."""
