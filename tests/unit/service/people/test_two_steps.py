"""`approval: true` over HTTP with login: who approves, who starts, what the audit has of it. No machine answers."""

from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from tests.unit.service.hosting import CONFIG, hosting
from tests.unit.service.people.conftest import calling

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def url(folder: Path, profile: Path) -> Iterator[str]:
    (folder / "cells").mkdir()
    (folder / "cells" / "workshop.yaml").write_text((CONFIG / "cells" / "workshop.yaml").read_text("utf-8"), "utf-8")
    with hosting(folder, profile, login=True, wrong_keys=1000, approval=True, cells_dir=str(folder / "cells")) as url:
        yield url


@pytest.fixture(scope="module")
def engineer(url: str, keys: dict[str, str]) -> Iterator[httpx.Client]:
    with calling(f"{url}/api/v1", keys["engineer"]) as http:
        yield http


@pytest.fixture(scope="module")
def plan(engineer: httpx.Client) -> int:
    wanted = {"varied": ["joint_2"], "step": 30.0, "poses": 1, "axes": ["joint_1"], "cell": "workshop"}
    robot = next(one["id"] for one in engineer.get("/robots").json()["items"] if one["name"] == "max100-class")
    answer = engineer.post("/plans", json={"robot_id": robot, **wanted}, timeout=600)
    assert answer.status_code == 201, answer.text
    return int(answer.json()["id"])


def test_two_people_and_two_steps(
    url: str, folder: Path, keys: dict[str, str], engineer: httpx.Client, plan: int
) -> None:
    campaign = engineer.post("/campaigns", json={"plan_id": plan}).json()["id"]
    start, approvals = f"/campaigns/{campaign}/start", f"/plans/{plan}/approvals"
    with calling(f"{url}/api/v1", keys["operator"]) as operator, calling(f"{url}/api/v1", keys["admin"]) as admin:
        refused = operator.post(start)
        assert (refused.status_code, refused.json()["detail"]) == (
            409,
            f"plan {plan} requires the approval of an engineer: not approved yet",
        )
        seen = operator.get(approvals).json()
        assert (seen["needed"], seen["missing"], seen["items"]) == (True, refused.json()["detail"], [])
        assert operator.post(approvals, json={"sha256": seen["sha256"]}).status_code == 403
        assert engineer.post(approvals, json={"sha256": "0" * 64}).status_code == 409

        # the name is that of the key, whatever is said
        made = engineer.post(approvals, json={"sha256": seen["sha256"], "approved_by": "somebody"})
        assert (made.status_code, made.json()["approved_by"], made.json()["void"]) == (201, "the-engineer", "")
        own = engineer.post(start)
        assert (own.status_code, own.json()["detail"]) == (
            409,
            f"plan {plan} is approved by the-engineer alone: another person must approve it, or start it",
        )
        assert operator.get(approvals).json()["missing"] == ""
        assert operator.post(start).status_code == 503  # all that is missing is a machine

        with (folder / "cells" / "workshop.yaml").open("a", encoding="utf-8") as cell:
            cell.write("\njoint_margin: 0.06\n")
        void = operator.post(start)
        assert (void.status_code, "is no longer valid" in void.json()["detail"]) == (409, True)
        assert "is no longer valid" in operator.get(approvals).json()["items"][0]["void"]
        audit = [one["entry"] for one in admin.get("/audit", params={"limit": 200}).json()["items"]]
    told = [one for one in audit if one["event"] == "outcome" and one.get("sha256") == seen["sha256"]]
    assert [(one["actor"], one["status"], one["plan"], one["by"]) for one in told] == [
        ("the-engineer", 201, plan, "the-engineer")
    ]
