"""What is made of sweeps beside the estimate: their spectra, a payload, the sheet for a control."""
