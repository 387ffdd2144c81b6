"""Regressor, base parameters, inverse dynamics and least squares; pure."""

# pyright: reportUnusedImport=false
from service.identification.model.base_parameters import (
    BaseParameters,
    Independence,
    combination_of,
    condition_number,
    joint_ranges,
    reduce_columns,
    spread_evenly,
)
from service.identification.model.inverse_dynamics import (
    JointMotion,
    Scale,
    coupling_rows,
    drive_rows,
    dynamic_base,
    dynamics_names,
    dynamics_rows,
    link_rows,
    link_sizes,
    nominal_parameters,
    parameter_spread,
    prior_information,
)
from service.identification.model.least_squares import (
    Information,
    LeftOut,
    Rank,
    SearchResult,
    Solution,
    converged,
    finite,
    jackknife_factor,
    scaled_inverse,
    scaled_solution,
    span,
    unsettled,
)
from service.identification.model.regressor import (
    SAME_POSITION,
    axis_rows,
    fold,
    gravity_rows,
    gravity_terms,
    inertia_rows,
    inertial_parameters,
    lock,
    parameter_names,
)
