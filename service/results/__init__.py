"""What results are, as frozen models: diagnosis, experiment, model revision, data check, estimate, initial analysis.

A result is made and stored as JSON, and its JSON is the format. A model reads it where it leaves mathematics or store,
so that whoever uses a result has names and types. Nothing is stored from a model: what was read stays as it was.
"""
