"""The service in virtual time: a campaign from start to estimate, a stop by the stop process, a kill."""

from typing import Any

import pytest

from tests.faults import FAULTS
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


# faults of the axis that is not the first of a simultaneous sweep, and the cause of its stop
CAUSES = {
    "drive fault": "drive_fault",
    "silent node": "communication_lost",
    "limit switch": "drive_fault",
    "torque saturation": "envelope_left",
    "emergency stop": "emergency_stop",
}


@pytest.mark.parametrize("name", CAUSES)
def test_a_fault_in_a_simultaneous_sweep_ends_in_standstill_of_both_axes(
    service: VirtualService, machine: VirtualMachine, clock: Clock, name: str
) -> None:
    order, details = FAULTS[name].make
    number = add_campaign(service, simultaneous=True)
    service.client.start(number)
    clock.wait_until(lambda: len(machine.energised()) == 2, "two axes have energy", 60.0)
    clock.sleep(2.0)
    machine.order(order, **details | ({"joint": "joint_2"} if "joint" in details else {}))
    clock.wait_until(lambda: service.client.campaign(number)["state"] == "paused", "paused", 60.0, 0.1)
    assert machine.stands()
    clock.sleep(1.0)
    assert not machine.energised()
    assert {sweep["structured_cause"]["code"] for sweep in service.client.sweeps(number)} == {CAUSES[name]}
