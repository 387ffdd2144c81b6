"""The virtual machine tool on a CAN bus: SDO, PDO, a node an axis, one clock.

Physics (`simulator.machine`), meaning (`simulator.drive`) and wire (`sdo`, `pdo`, `node`) are apart. Nothing here does
I/O or reads a clock: frames and times come in, frames go out (`cabinet`).
"""
