"""Drives of other manufacturers: nodes with exactly the objects of an EDS or DCF, driving the virtual drive's plant.

Based on CiA 301, CiA 402 and the manufacturers' published firmware documentation (`makers`), not on the code of any
host: a wrong assumption of a host about a drive is detected here. Units, modes and option codes come from the file;
properties without a file entry are in one table. Nothing here does I/O or reads a clock: frames and times are
inputs, frames are outputs.
"""
