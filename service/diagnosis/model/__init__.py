"""What is added to the model, and what it changes on data it has not seen."""
