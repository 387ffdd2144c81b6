"""Drives of other makers: nodes with exactly the objects of an EDS or DCF, before the virtual drive's plant.

Built from CiA 301 and CiA 402 and from what makers publish of their firmware (`makers`), not from any host's code:
a host that is wrong about a drive shall find out here. Units, modes and option codes are the file's; what a file has no
words for is in one table. Nothing here does I/O or reads a clock: frames and times come in, frames go out.
"""
