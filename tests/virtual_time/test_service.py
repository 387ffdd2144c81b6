"""The service in virtual time: a campaign from start to estimate, a stop by the stop process, a kill."""

from typing import Any

import pytest

from tests.virtual_time.clock import Clock
from tests.virtual_time.machine import VirtualMachine
from tests.virtual_time.service import VirtualService, add_campaign


@pytest.mark.parametrize("changes", [{}, {"modes": "host_streamed"}, {"simultaneous": True}])
def test_a_campaign_is_measured_and_identified(
    service: VirtualService, machine: VirtualMachine, clock: Clock, changes: dict[str, Any]
) -> None:
    number = add_campaign(service, **changes)
    service.client.start(number)
    clock.wait_until(lambda: service.client.campaign(number)["state"] == "completed", "completed", 600.0, 1.0)
    assert service.client.campaign(number)["sweeps"] == {"identified": 2}
    assert machine.stands()


def test_a_stop_that_is_not_waited_for_says_only_that_it_was_sent(
    service: VirtualService, machine: VirtualMachine, clock: Clock
) -> None:
    service.press_stop().get()
    clock.sleep(0.5)  # every drive has been heard by now
    status, by_port = service.press_stop(wait=0.0).get()
    answer = service.send("POST", "/stop?by=Ada&wait=0").result()
    assert (status, answer.status_code) == (202, 202)
    for body in (by_port, answer.json()):
        assert ({*body["sent"]}, [*body["confirmed"]], body["unconfirmed"]) == ({*machine.axes()}, [], {})


def test_a_killed_service_leaves_a_machine_that_stands_and_a_campaign_that_a_person_resumes(
    service: VirtualService, machine: VirtualMachine, clock: Clock
) -> None:
    number = add_campaign(service)
    service.client.start(number)
    clock.wait_until(lambda: abs(machine.axes()["joint_1"]["velocity"]) > 0.01, "moves")
    service.kill()
    assert clock.wait_until(machine.stands, "stands") < 1.0
    service.start()
    assert service.client.campaign(number)["state"] == "paused"
    clock.sleep(10.0)
    assert machine.stands()
    service.client.resume(number, repeat=True)
    clock.wait_until(lambda: service.client.campaign(number)["state"] == "completed", "completed", 600.0, 1.0)
