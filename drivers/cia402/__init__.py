"""What CiA 402 drives have in common, whatever the fieldbus: states, limits, power, positioning, measuring function.

A fieldbus (`drivers.canopen`, `drivers.modbus`) brings a `Device` an axis; nothing here knows frames or registers.
"""
