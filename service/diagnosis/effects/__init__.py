"""The catalogue of effects, in the order of explanation: simple effects first, those of other packages last."""

from service.diagnosis.effects.drive_train import BACKLASH, COGGING_TORQUE, JOINT_ELASTICITY, TRANSMISSION_ERROR
from service.diagnosis.effects.effect import Catalogue
from service.diagnosis.effects.friction import (
    ASYMMETRIC_FRICTION,
    COULOMB_FRICTION,
    FRICTION_TEMPERATURE_DRIFT,
    LOAD_DEPENDENT_FRICTION,
    NONLINEAR_VISCOUS_FRICTION,
    PRESLIDING_HYSTERESIS,
    STRIBECK_FRICTION,
)
from service.diagnosis.effects.load import COUNTERBALANCE, GRAVITY_ERROR, HOSE_SPRING, PARALLELOGRAM, PAYLOAD
from service.diagnosis.effects.measurement import EFFORT_OFFSET, MEASUREMENT_DELAY, TORQUE_CONSTANT_ERROR

CATALOGUE = Catalogue(
    (
        COULOMB_FRICTION,
        ASYMMETRIC_FRICTION,
        STRIBECK_FRICTION,
        NONLINEAR_VISCOUS_FRICTION,
        LOAD_DEPENDENT_FRICTION,
        FRICTION_TEMPERATURE_DRIFT,
        GRAVITY_ERROR,
        HOSE_SPRING,
        COUNTERBALANCE,
        JOINT_ELASTICITY,
        MEASUREMENT_DELAY,
        COGGING_TORQUE,
        TRANSMISSION_ERROR,
        PRESLIDING_HYSTERESIS,
        BACKLASH,
        EFFORT_OFFSET,
        TORQUE_CONSTANT_ERROR,
        PAYLOAD,
        PARALLELOGRAM,
    )
)
"""All effects by name."""
