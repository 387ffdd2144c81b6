"""Motion: execution of sweeps, the stop process, programs for a CNC without fieldbus."""
