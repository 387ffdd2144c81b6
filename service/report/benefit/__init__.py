"""Benefit of an estimate: the drive torque of held-out sweeps, predicted by CAD and by the estimate."""
