"""One axis: inertia, friction, elasticity and known effects from its sweeps."""
