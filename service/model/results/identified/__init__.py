"""Results of sweeps other than the estimate: spectra, payload, sheet for a control."""
