"""The virtual machine tool on a CAN bus: dictionary, CiA 402 axes, measuring function, one clock.

Physics (`simulator.machine`), meaning (`axis`) and wire (`sdo`, `pdo`, `node`) are apart. Nothing here does I/O or
reads a clock: frames and times come in, frames go out (`cabinet`).
"""
