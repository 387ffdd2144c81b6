"""The next experiment that a diagnosis proposes for an axis."""

from service.recording import SweepSpec
from service.results.part import Part

TEST_MASS = "test_mass"  # the kind whose sweeps are run with a known mass on the last link


class ExperimentSweep(Part):
    """A sweep as it was designed; `ramp` and `settle`, s."""

    spec: SweepSpec
    ramp: float
    settle: float


class Experiment(Part):
    """What to measure next and why; `seconds` of machine time.

    `kind`: a block, `full_design`, `more_poses`, `warm_up` or `test_mass`. `separation`: chi-squared by which it is
    expected to tell the effects `between` apart, null where that was not computed.
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
        """True where somebody has to bolt a known mass on."""
        return self.kind == TEST_MASS
