"""The virtual machine tool on a CAN bus: SDO, PDO, one node per axis, one clock.

Physics (`simulator.machine`), drive behaviour (`simulator.drive`) and protocol (`sdo`, `pdo`, `node`) are separate.
Nothing here does I/O or reads a clock: frames and times are inputs, frames are outputs (`cabinet`).
"""
