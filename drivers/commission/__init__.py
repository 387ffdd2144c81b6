"""Commissioning of unknown CANopen drives: draft the files of a machine, check the wiring without energy.

`draft` makes a profile and a device map from an EDS or DCF. `survey` runs `checks` and `units` on every drive of a
profile and makes a sheet, which a person signs. None of these writes an object of a drive (`drive.ReadOnlySdo`) or
sends a NMT command: no axis can be energised, and the next check judges the same drive. Only `moving` moves an axis,
through a `DrivePort`, after a person has typed its name.
"""
