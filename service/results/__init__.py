"""What results are, as frozen models: estimate, diagnosis, experiment, model revision, data check, payload, sheet.

Estimate, payload and sheet are made as models, and their JSON is what is written and stored. Diagnosis and data check
make JSON, which a model reads where it leaves mathematics or store. Either way the JSON is the format: a model gives
back what it read, key by key.
"""
