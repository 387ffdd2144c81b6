"""All results as frozen models: estimate, diagnosis, experiment, model revision, data check, payload, sheet.

Estimate, payload and sheet are computed as models; their JSON is written and stored. Diagnosis and data check are
computed as JSON, which is read into a model outside of the mathematics and the store. JSON is always the format: a
model writes the same keys that it has read.
"""
