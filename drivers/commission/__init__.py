"""Commissioning of unknown CANopen drives: draft the files of a machine, check the wiring without energy.

`dictionary` reads an EDS or DCF; `draft` makes a profile and a device map from it. `survey` runs the checks of
`identity`, `objects`, `units` and `settings` on every drive of a profile and makes a `sheet`, which a person signs.
None of these writes an object of a drive (`read_only_drive`) or sends a NMT command: no axis can be energised, and the
next check judges the same drive. Only `moving` moves an axis, through a `DrivePort`, after a person has typed its name.
"""
