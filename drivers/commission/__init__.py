"""Commissioning of unknown CANopen drives: draft the files of a machine, check the wiring without energy.

`dictionary` reads an EDS or DCF; `draft` makes a profile and a device map from it. `survey` runs the checks of
`identity`, `objects`, `units` and `settings` on every drive of a profile and makes a `sheet`, which a person signs.
None of these writes a controlword, a mode or a set-point (`read_only_drive`), and no node is set to NMT operational:
no axis can be energised. Only `moving` moves an axis, through a `DrivePort`, after a person has typed its name.
"""
