"""The page of the soak says what its runs found, and would say what they broke."""

from tests.soak.table import PAGE, Result, page, whole_page


def run(way: str, times: int, lost: dict[str, float], moved: list[str], broken: list[str]) -> Result:
    return Result.model_validate(
        {
            "way": way,
            "seed": 1,
            "at": "2026-11-23T21:47+00:00",
            "disturbances": {"STOP": {"times": times, "ended": times}},
            "moved_unasked": moved,
            "broken": broken,
            "campaigns": 1,
            "sweeps": 12,
            "attempts": 30,
            "lost_ms": lost,
            "to_rest_s": {"median": 0.0, "longest": 5.04},
            "unplanned": [],
        }
    )


def test_the_page_is_of_the_results() -> None:
    assert PAGE.read_text("utf-8") == whole_page(), "run: python -m tests.soak.table"


def test_runs_of_a_way_add_up() -> None:
    told = page(
        [run("modbus", 7, {"STOP": 3.2}, [], []), run("modbus", 14, {"STOP": 41.7}, ["joint_1"], ["campaign 3"])]
    )
    assert "| STOP | 21 | 21 | 42 |" in told
    assert "| **motions unasked** | 1 |" in told
    assert "| **campaigns with a sweep lost or counted twice** | 1 |" in told


def test_what_never_happened_is_no_zero() -> None:
    told = page([run("canopen", 7, {}, [], []), run("modbus", 2, {"STOP": 0.0}, [], [])])
    assert "| STOP | 7 | 7 | – | 2 | 2 | 0 |" in told
