"""The catalogue of effects, in the order of explanation: simple effects first, those of other packages last."""

from service.diagnosis.effects.catalogue import Catalogue
from service.diagnosis.effects.drive_train import backlash, cogging_torque, joint_elasticity, transmission_error
from service.diagnosis.effects.friction import (
    asymmetric_friction,
    coulomb_friction,
    friction_temperature_drift,
    load_dependent_friction,
    nonlinear_viscous_friction,
    presliding_hysteresis,
    stribeck_friction,
)
from service.diagnosis.effects.load import gravity_error, hose_spring, payload
from service.diagnosis.effects.measurement import effort_offset, measurement_delay, torque_constant_error

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

CATALOGUE = Catalogue(module.EFFECT for module in _MODULES)
"""All effects by name."""
