"""The state of the machine: stops that hold it, stop sequences that run, questions to its drives."""
