"""The extended model, and its test on data that were not used to fit it."""
