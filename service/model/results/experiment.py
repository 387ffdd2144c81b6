"""The next experiment that a diagnosis proposes for an axis."""

from service.model.recording import SweepSpec
from service.model.results.part import Part

TEST_MASS = "test_mass"  # the kind whose sweeps are run with a known mass on the last link


class ExperimentSweep(Part):
    """A designed sweep; `ramp` and `settle`, s."""

    spec: SweepSpec
    ramp: float
    settle: float


class Experiment(Part):
    """What to measure next, and the reason; `seconds` of machine time.

    `kind`: a block, `full_design`, `more_poses`, `warm_up` or `test_mass`. `separation`: expected chi-squared of the
    difference of the effects `between`, null if it was not computed.
    """

    kind: str
    blocks: tuple[str, ...]
    sweeps: tuple[ExperimentSweep, ...]
    seconds: float
    separation: float | None
    between: tuple[str, ...]
    reason: str

    @property
    def weighs(self) -> bool:
        """True if a known mass must be mounted."""
        return self.kind == TEST_MASS
