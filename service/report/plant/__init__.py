"""The report of the robots of a plant."""
