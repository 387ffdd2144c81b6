"""Plans of the experiments that a diagnosis requests."""
