"""Plans of the experiments that a diagnosis asks for."""
