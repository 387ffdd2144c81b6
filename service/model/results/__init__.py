"""All results as frozen models: estimate, diagnosis, experiment, model revision, data check, payload, sheet.

They are computed as models; their JSON is written and stored, and a model writes the same keys that it has read.
"""
