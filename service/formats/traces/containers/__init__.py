"""Traces in files with many channels, units and clocks: MDF4 (`mdf4`) and HDF5 (`hdf5`).

Third-party libraries read them in a separate process (`reading`) with limits of memory and time. The format of request
and answer is in `request`.
"""
