"""Texts of the page; every figure comes from a results file."""

TITLES = {
    "selection": "Planning: selection of poses",
    "rows": "Regressor and base parameters",
    "plant": "The virtual plant",
    "revisions": "From sweeps to estimates",
    "diagnosis": "Diagnosis",
    "wire": "From the wire to the disk",
    "service": "The service during a sweep",
    "minutes": "Robot minutes to an accuracy",
    "bound": "Variance over the Cramér-Rao bound",
    "growth": "Growth of the cost",
}

TEXT = """# Benchmarks

This page compares the cost of sweepid with that of alternatives ("peers"): `make bench` measures both sides in one run.
It is written by `python -m tests.benchmarks.bench` from `tests/benchmarks/results/bench.json`; every figure is
measured.

Both sides of a row run alternately (ours, peer, ours, peer), so that other load of the computer affects both. The value
is the median; the spread is the difference of the largest and the smallest value of ours, divided by the median. Pure
computation is measured in seconds of processor time, which other load hardly changes; operations that wait for a bus, a
disk or a server are measured in seconds of the clock. "Times better" is the factor by which ours is faster, or smaller
where less is better, than the peer: below 1 the peer is better. The ratios are the result; the seconds are those of
this computer.

The computer: {processors} shared cores of a virtual server, {processor}, {memory_GiB} GiB, {system}; Python {python};
{packages}.
Threads per call of linear algebra: {threads}. Other work ran on it at the same time: the load average was between
{least_load:.1f} and {most_load:.1f} on {processors} cores, so times of the clock are much longer than on a dedicated
computer. Each section states the load during its own run.
"""

REMARKS = {
    "selection": """\
Axes 2 and 3 are varied over 48 x 36 poses, as in the grid of the paper. The time of the peer includes the same grid and
collision checks as ours.""",
    "rows": """\
Pinocchio computes the torque regressor of all joints; one row of it belongs to the axis.""",
    "revisions": """\
The peer does less: the paper's formula for each sweep separately, plain least squares, no covariance, no common drive
train, no comparison over the workspace, no document.""",
    "diagnosis": """\
There is no peer. The limit is the time that the machine needs to measure the same sweeps.""",
    "wire": """\
The bus is a socketcand gateway that sends six axes as fast as the client reads. One machine with six axes at 250 Hz
needs 1,500 samples per second. The figure by the clock includes waiting for the disk at each block of 25 samples, as in
a
recording.""",
    "service": """\
The virtual machine, the service, its worker and the bare route are separate processes on the same cores. The time-outs
of
the bus are long, so that delays appear in the figures and do not end a sweep.""",
    "minutes": """\
RMSE of J over the collision-free grid relative to the truth of the plant, for the worst axis, mean of two measurements
each. An empty field means that the accuracy was not reached with the poses tried. The paper's formula is biased by the
elasticity of this plant, and more poses do not help. Compared with random poses of the same grid the selection gains
little
here: the gain comes from the joint fit, and the selection criterion is the volume of the parameters, not this
error.""",
    "bound": """\
The data are from the second plant; bound and fit are those of `tests/benchmarks/monte_carlo.py`. The variance is that
of J
over 100 draws of noise and motor inertia.""",
    "growth": """\
Exponent n of cost ~ size^n, fitted to the logarithms; the smaller of two repeats each.""",
    "missed": """\
**A revision** is more than adding a sweep to the previous revision: all sweeps of an axis share one drive train, so
each revision fits them jointly again, checks for outliers, predicts held-out sweeps and compares over the workspace.
Its cost grows much more slowly than the number of sweeps (see above). If the fit of a revision started at the end of
the previous one, it would save the first search; but then the estimate would depend on the order of the sweeps, which
it does not now. Nothing waits for a revision: the next sweep takes seconds.

**Through the queue**, a revision takes its computing time plus the wait for a processor: the worker intentionally has
lower priority than machine, service and all other processes here, and its first job imports the mathematics.

**The wire**: reading by python-can is the smaller part. The rest is one Python object per frame, sorting by node, a
queue between two threads, pairing by the counter of the drive, the comparisons of the envelope, the blocks and, by the
clock, the disk that must store each block. The rate is much higher than six axes need. Reading arrays of whole lines
from the socket
would be faster, but would check the envelope only in batches; therefore it is not done.""",
    "profiles": """\
The three slowest paths, and those that miss a target, by cProfile. Its own cost is included in the lines but not in the
headings.""",
    "the whole plan of 300 poses, three axes": """\
Possible improvement: most of the time is for the paths between poses and their collision checks, not for the selection.
Paths that start from the same pose could share one call of the checker.""",
    "selection of 300 of 20,000 poses, six axes": """\
Possible improvement: most of the time is for eigenvalues of the tighter bound and of the candidates that no bound
excludes. Candidates that were far from the best for many steps could be left out until their bound, which decreases
slowly, requires
them (lazy greedy); the selection would stay the same.""",
    "virtual plant, 900 sweeps": """\
Possible improvement: the sines of the torque ripple are the largest part; they could be updated by a rotation in each
step instead of evaluated. The rest are many operations on short rows, which only a compiled step would combine. The
target is
met.""",
    "revision 900": """\
Possible improvement: see the targets that are missed.""",
    "diagnosis of one axis": """\
Possible improvement: filters and regressors of each sweep are independent and could run on several cores; the worker
has
one.""",
    "short": """\
`tests/benchmarks/test_ratios.py` measures these ratios again with each run of all tests: pure computation only, the
best of
several repeats in processor time. It fails if a ratio is 30 % worse than here, or 50 % on another kind of
processor.""",
}
