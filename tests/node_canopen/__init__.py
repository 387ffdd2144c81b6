"""CANopen drives of the stack node-canopen (npm `canopen`), with plants of their own, in JavaScript.

`main.js` is the machine, a process; `tests.independent_bench` starts it. Nothing here is of this project's product, of
python-canopen or of durand: bus, dictionary, PDOs, SDOs, NMT and EMCY are node-canopen's, the socketcand server is
`bus.js`.
"""
