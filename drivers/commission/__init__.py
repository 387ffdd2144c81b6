"""Commissioning of unknown CANopen drives: draft the files of a machine, check the wiring without energy.

`dictionary` reads an EDS or DCF; `draft` makes a profile and a device map of it. `survey` asks every drive of a profile
what `identity`, `objects`, `units` and `settings` want to know and makes a `sheet` of it, which a person signs. None of
these writes a controlword, a mode or a set-point (`quiet`), and no node is sent into NMT operational: no axis can get
energy by it. `moving` alone moves an axis, through a `DrivePort`, after a person has typed its name.
"""
