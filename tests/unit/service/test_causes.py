"""Whatever ends a motion has a code: by its class, and by what the campaign makes of an error that has none."""

import asyncio
import importlib
import inspect
import pkgutil

import pytest
from sqlalchemy.exc import OperationalError

import drivers
import service.machine.execution
import service.planning.safety
from drivers.errors import Cause, CauseCode, CausedError, DriveFault, EnvelopeLeft, LimitExceeded, Measured, NotReady
from service import BadInput, Conflict, EnvelopeViolation, NotFound, SweepidError
from service.machine.execution.sweep_executor import cause_of_error
from service.model.causes import in_words, read
from service.web.hmi.pages import texts

ROOMS = (drivers, service.machine.execution, service.planning.safety)


def errors() -> set[type[BaseException]]:
    """The classes of errors that the code between the service and a drive defines."""
    names = [found.name for room in ROOMS for found in pkgutil.walk_packages(room.__path__, f"{room.__name__}.")]
    told = [name for name in names if not name.startswith("drivers.contract") and not name.endswith("__main__")]
    held = [pair for name in told for pair in inspect.getmembers(importlib.import_module(name), inspect.isclass)]
    return {one for _, one in held if issubclass(one, CausedError | SweepidError) and one.__module__ in told}


def test_each_error_of_a_motion_has_a_code_of_its_own() -> None:
    found = errors()
    assert {"DriveFault", "KernelRefused", "CheckMoveFailed", "SamplesMissing"} <= {one.__name__ for one in found}
    without = {one.__name__ for one in found if getattr(one, "code", CauseCode.INTERNAL) is CauseCode.INTERNAL}
    assert without == {"CausedError", "DriveError"}  # the bases, which nobody raises


@pytest.mark.parametrize("base", [CausedError, DriveFault, EnvelopeViolation])
def test_an_error_that_is_planted_without_a_code_is_refused(base: type[BaseException]) -> None:
    with pytest.raises(TypeError, match="code"):
        type("Planted", (base,), {})


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (Conflict("not now"), CauseCode.REFUSED),
        (NotFound("campaign 7"), CauseCode.REFUSED),
        (BadInput("file", "is damaged"), CauseCode.REFUSED),
        (OSError(28, "No space left on device"), CauseCode.NOT_STORED),
        (OperationalError("insert", {}, Exception("database is locked")), CauseCode.NOT_STORED),
        (asyncio.CancelledError(Cause(CauseCode.SIGN_OF_LIFE)), CauseCode.SIGN_OF_LIFE),
        (ZeroDivisionError(), CauseCode.INTERNAL),
    ],
    ids=lambda value: type(value).__name__,
)
def test_any_other_error_has_one_too(error: BaseException, code: CauseCode) -> None:
    assert cause_of_error(error).code is code


@pytest.mark.parametrize(
    ("error", "cause"),
    [
        (NotReady("not connected"), Cause(CauseCode.NOT_READY, detail="NotReady: not connected")),
        (
            DriveFault("joint_1 (node 3)", "7305h", measured=Measured(0x7305, None, "hex")),
            Cause(CauseCode.DRIVE_FAULT, "joint_1", 0x7305, unit="hex", detail="DriveFault: joint_1 (node 3): 7305h"),
        ),
        (
            EnvelopeLeft("joint_1 (node 1), joint_2 (node 2)", "late"),
            Cause(CauseCode.ENVELOPE_LEFT, detail="EnvelopeLeft: joint_1 (node 1), joint_2 (node 2): late"),
        ),
        (
            EnvelopeViolation("j1", "no", measured=Measured(float("nan"), 2.0, "rad"), code=CauseCode.PATH_NOT_FREE),
            Cause(CauseCode.PATH_NOT_FREE, "j1", None, 2.0, "rad", detail="EnvelopeViolation: j1: no"),
        ),
        (LimitExceeded("late", joint="j2"), Cause(CauseCode.LIMIT_EXCEEDED, "j2", detail="LimitExceeded: late")),
    ],
    ids=lambda value: type(value).__name__,
)
def test_an_error_carries_axis_value_and_limit(error: CausedError, cause: Cause) -> None:
    assert error.cause == cause


@pytest.mark.parametrize("code", CauseCode)
def test_each_code_is_told_with_the_next_step(code: CauseCode) -> None:
    told = in_words(Cause(code, "joint_7", by="anna", detail="smoke"))
    assert texts()["en"][f"step.{code}"].format(axis="joint_7") in told
    assert "{" not in told
    assert "smoke" in told


@pytest.mark.parametrize(
    ("cause", "told"),
    [
        (Cause(CauseCode.DRIVE_FAULT, "j1", 0x7305, unit="hex"), "j1: the drive reports a fault (7305h). Look"),
        (
            Cause(CauseCode.ENVELOPE_LEFT, "j1", -0.53232, -0.532319, "rad"),
            "j1: outside its limits (-30.4997°, limit -30.4996°). Find out",
        ),
        (Cause(CauseCode.ENVELOPE_LEFT, "j2", 0.0512, 0.05, "m"), "j2: outside its limits (51.2 mm, limit 50 mm). "),
        (Cause(CauseCode.SIGN_OF_LIFE, limit=2.0, unit="s"), "no sign of life of a person (limit 2 s). Check"),
        (Cause(CauseCode.STOPPED, by="anna", detail="smoke"), "stopped by anna: smoke. Check the machine"),
    ],
    ids=str,
)
def test_a_cause_is_told_in_degrees_and_millimetres(cause: Cause, told: str) -> None:
    assert in_words(cause).startswith(told)


def test_a_cause_in_an_answer_of_the_api_is_the_same() -> None:
    cause = Cause(CauseCode.HOST_GAP, value=5.2, limit=1.0, unit="s", by="host watch", detail="suspended")
    fields = {name: getattr(cause, name) for name in Cause.__dataclass_fields__}
    assert read({**fields, "code": "host_gap"}) == cause
