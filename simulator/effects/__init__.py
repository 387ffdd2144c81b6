"""Physics of a drive train beyond inertia, spring, and viscous and Coulomb friction: one small module per effect."""
