"""Mass, centre and inertia of a payload from equal motions with and without it."""
