"""Publishes the state of machine, campaign and estimate to other systems, by OPC UA and MQTT.

`state` defines the data, `following` collects them in the service, `publisher` sends them to a separate process,
which runs the OPC UA server (`opcua`) and the MQTT client (`mqtt`). The service never waits for it.
"""
