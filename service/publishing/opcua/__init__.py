"""The OPC UA server: `server` listens, `access` checks permissions, `nodes` and `load_type` define the nodes."""
