"""CANopen drives of the stack `durand` before a plant of their own, and nothing of this project's or python-canopen's.

`python -m tests.durand_nodes` is the machine, a process; `tests.independent_bench` starts it. The socketcand
server alone is the simulator's.
"""
