"""Common behaviour of CiA 402 drives on every fieldbus: states, limits, power, positioning, measuring function.

A fieldbus (`drivers.canopen`, `drivers.modbus`) implements one `Device` per axis. Frames and registers stay there.
"""
