"""Which tests are of the second tier, `make test-long`, and in which of its parts.

There a property is repeated on further buses, drives, makers, seeds, cells or processes, or with records of full size;
the first tier, `make test`, has each once. What docs/explanation/safety.md names is of the first.
"""

from functools import cache
from typing import NamedTuple

from tests.faults import ADAPTERS, FAULTS

PARTS = 10  # each `.ci/run` runs one of them

_TABLE = "tests/system/test_fault_table.py::test_a_fault_ends_in_standstill_and_waits_for_a_person"
_STOP = "tests/system/test_stop.py"
_PORT = "tests/contract/test_drive_port.py"
_DEATH = "tests/contract/test_death.py"
_PORT_FAULTS = "tests/contract/test_faults.py"

_BENCHES = {  # processor time of a whole suite, s
    "canopen-socketcand": 10.0,
    "canopen-virtual": 8.0,
    "durand-socketcand": 7.0,
    "epos4-virtual": 5.0,
    "modbus-rtu": 8.0,
    "modbus-tcp": 8.0,
    "node-socketcand": 7.0,
    "plain-virtual": 5.0,
}

SHORT = (  # stays in the first tier although a line of LONG names it: file[::function][[first parameters]
    # the wiring of each bus and each stack
    *(
        f"{test}[{bench}"
        for test in (
            f"{_PORT}::test_connect_leaves_every_axis_disabled",
            f"{_PORT}::test_identity_is_checked",
            f"{_PORT}::test_move_arrives_at_standstill",
            f"{_PORT}::test_stop_from_another_task_and_twice",
            f"{_PORT}::test_sweep_delivers_consecutive_samples_of_what_was_commanded",
            f"{_PORT_FAULTS}::test_emergency_stop_in_a_sweep",
            f"{_PORT_FAULTS}::test_fault_in_a_sweep_delivers_what_there_is_and_waits_for_a_person",
        )
        for bench in (
            "canopen-socketcand",
            "durand-socketcand",
            "epos4-virtual",
            "modbus-rtu",
            "modbus-tcp",
            "node-socketcand",
        )
    ),
    # that of the kernel's bus, beside tests/vcan
    f"{_PORT}::test_move_arrives_at_standstill[canopen-vcan",
    f"{_PORT}::test_stop_from_another_task_and_twice[canopen-vcan-host_streamed",
    f"{_PORT}::test_sweep_delivers_consecutive_samples_of_what_was_commanded[canopen-vcan",
    f"{_PORT}::test_sweep_delivers_consecutive_samples_of_what_was_commanded[node-vcan",
    f"{_PORT_FAULTS}::test_emergency_stop_in_a_sweep[canopen-vcan-host_streamed",
    # a fault at each adapter, through the service
    f"{_TABLE}[CANopen, drive's own sweep-drive fault",
    f"{_TABLE}[CANopen, streamed sweep-emergency stop",
    f"{_TABLE}[Modbus TCP-limit switch",
    # hidden effects and faults of data, of each kind one
    "tests/numeric/test_data_check.py::test_a_fault_of_the_second_plant_is_told[torque_sign]",
    "tests/numeric/second_plant/test_cases.py::test_a_large_effect_is_seen_and_no_monster[coulomb_friction]",
    "tests/numeric/second_plant/test_scoring.py::test_a_fair_sample_goes_through[00001",
    "tests/numeric/second_plant/test_scoring.py::test_a_fair_sample_goes_through[01000",
    "tests/numeric/test_channel_timing.py::test_lags_are_found_within_their_uncertainty[none-joint_1",
    "tests/numeric/test_channel_timing.py::test_lags_are_found_within_their_uncertainty[both-joint_2",
    "tests/numeric/test_foreign_machines.py::test_what_a_foreign_machine_hides_is_found[01",
    "tests/numeric/test_foreign_machines.py::test_what_a_foreign_machine_hides_is_found[08",
    "tests/numeric/test_makers_robots.py::test_from_a_makers_urdf_to_its_inertia[panda",
    "tests/numeric/test_payload.py::test_friction_that_changed_is_told_as_no_load[232",
    "tests/numeric/test_payload.py::test_friction_that_changed_is_told_as_no_load[820",
    "tests/numeric/test_planned_confidence.py::test_a_campaign_to_a_confidence_keeps_what_its_plan_promises[0.3-springs0",
    "tests/numeric/second_plant/test_play.py::test_backlash_is_named_with_its_width[medium-0.0",
    "tests/numeric/second_plant/test_play.py::test_no_other_machine_has_play[presliding_hysteresis-medium",
)

LONG: dict[str, float] = {  # file[::function][[first parameters]: processor time in s, on an idle computer
    # the contract that tests/virtual_time/test_drive_port.py shows, on each transport, dictionary, stack and line
    **{f"{_PORT}[{bench}": cost for bench, cost in _BENCHES.items()},
    **{f"{_PORT_FAULTS}[{bench}": cost / 2 for bench, cost in _BENCHES.items()},
    "tests/contract/test_canopen.py[canopen-virtual": 4,
    "tests/contract/test_noise.py[canopen-virtual": 4,
    "tests/contract/test_other_makers.py": 10,
    "tests/contract/test_independent.py::test_a_streamed_sweep_gives_the_inertia_of_the_plant[node-canopen": 12,
    "tests/contract/test_cells.py": 14,
    **{
        f"{_DEATH}::{function}[{bench}": cost
        for function, cost in (
            ("test_axes_stand_after_the_host_hung_and_nothing_resumes", 5),
            ("test_a_busy_moment_of_the_machine_or_the_host_ends_no_streamed_sweep", 4),
            ("test_a_machine_that_dies_is_lost_communication", 1),
        )
        for bench in ("durand-socketcand", "node-socketcand", "modbus-rtu", "canopen-vcan", "node-vcan")
    },
    **{
        f"{_DEATH}::test_axes_stand_after_the_host_was_killed[{bench}": 5
        for bench in ("durand-socketcand", "node-socketcand", "modbus-rtu")
    },
    f"{_DEATH}::test_axes_stand_after_the_host_hung_and_nothing_resumes[modbus-tcp": 5,
    f"{_DEATH}::test_a_busy_moment_of_the_machine_or_the_host_ends_no_streamed_sweep[canopen-socketcand": 4,
    # the same contract on the kernel's bus, in a guest that is three times as slow
    **{
        f"tests/contract/{file}[{bench}": cost
        for file, bench, cost in (
            ("test_drive_port.py", "canopen-vcan-drive_side", 60),
            ("test_drive_port.py", "canopen-vcan-host_streamed", 60),
            ("test_drive_port.py", "canopen-vcan", 40),
            ("test_drive_port.py", "node-vcan", 50),
            ("test_faults.py", "canopen-vcan-drive_side", 40),
            ("test_faults.py", "canopen-vcan-host_streamed", 40),
            ("test_faults.py", "canopen-vcan", 40),
            ("test_faults.py", "node-vcan", 50),
            ("test_canopen.py", "canopen-vcan", 40),
            ("test_noise.py", "canopen-vcan", 40),
        )
    },
    **{
        f"{_DEATH}::{test}": 15
        for test in (
            "test_axes_stand_after_the_host_was_killed[node-vcan",
            "test_connect_restores_the_speed_control_that_a_killed_host_left_soft[canopen-vcan",
            "test_the_drive_restores_its_speed_control_after_the_host_was_killed_in_a_noise_run[canopen-vcan",
        )
    },
    # faults, through the service at each adapter
    **{f"{_TABLE}[{adapter.name}-{fault}": 8 for adapter in ADAPTERS for fault in FAULTS},
    # a walk at random
    "tests/system/test_any_order.py": 22,
    # what parts show by themselves, shown again by all processes together, or for a second way, drive or database
    "tests/system/test_attack.py": 30,
    "tests/virtual_time/test_axes_at_once.py::test_a_trajectory_is_identified_with_sweeps_and_alone": 40,
    "tests/system/test_demo.py::test_interrupted_demo_stops_the_machine_first": 18,
    "tests/system/test_diagnosis_campaign.py::test_the_other_blocks_run_and_none_spoils_the_inertia": 8,
    "tests/system/test_diagnosis_campaign.py::test_the_loop_runs_alone_on_a_virtual_machine": 12,
    "tests/system/test_diagnosis_campaign.py::test_the_runbook_goes_from_a_campaign_to_the_accepted_model": 15,
    "tests/system/test_runbooks.py::test_a_night_ends_with_the_confidence": 10,
    "tests/system/test_runbooks.py::test_an_unchanged_machine_passes_the_daily_check": 10,
    "tests/system/test_runbooks.py::test_another_load_is_a_change": 10,
    "tests/system/test_runbooks.py::test_another_load_is_red": 10,
    "tests/system/test_runbooks.py::test_sigterm_stops_the_machine_and_after_a_stop_leads_on": 15,
    "tests/system/test_runbooks.py::test_the_sheet_tells_the_robot_from_one_with_another_load": 10,
    "tests/system/test_runbooks.py::test_a_backup_is_restored_once_the_service_has_ended": 8,
    "tests/system/test_runbooks.py::test_a_damaged_backup_is_not_restored": 5,
    "tests/system/test_runbooks.py::test_a_trace_becomes_an_inertia": 8,
    "tests/system/test_diagnosis_campaign.py::test_a_fault_ends_it_and_the_machine_stands": 5,
    "tests/system/test_initial_analysis.py::test_a_drive_that_cannot_inject_gets_a_stepped_sine": 9,
    "tests/system/test_makers_urdf.py::test_the_commands_lead_to_a_plan": 15,
    "tests/system/test_monitoring.py::test_a_real_prometheus_scrapes_a_service_and_answers": 9,
    "tests/system/test_runbooks.py::test_a_backup_is_made_and_rehearsed": 8,
    "tests/system/test_runbooks.py::test_a_payload_is_known_with_its_sheet": 30,
    "tests/system/test_runbooks.py::test_a_fault_ends_the_night_and_nothing_is_resumed": 8,
    "tests/system/test_tutorials.py::test_the_first_campaign": 45,
    "tests/system/test_tutorials.py::test_a_hidden_effect_is_found": 20,
    "tests/system/test_two_cells.py": 22,
    f"{_STOP}::test_measure_told_to_end_stops_the_machine[SIGHUP": 4,
    f"{_STOP}::test_measure_told_to_end_stops_the_machine[SIGTERM": 4,
    f"{_STOP}::test_on_modbus_it_writes_the_registers_by_a_connection_of_its_own": 10,
    f"{_STOP}::test_told_to_end_the_machine_comes_before_open_requests[SIGHUP": 8,
    f"{_STOP}::test_told_to_end_the_machine_comes_before_open_requests[SIGINT": 8,
    # further states of the page
    "tests/browser/test_login.py::test_events_and_reports_come_with_the_key": 9,
    "tests/browser/test_page_truth.py::test_resume_shows_what_it_moves_and_what_cannot_work_says_why": 9,
    "tests/browser/test_payload_page.py::test_from_the_plan_to_the_sheet": 60,
    "tests/browser/test_report_print.py::test_it_is_accessible_and_on_paper_no_figure_is_cut_and_none_is_empty": 5,
    # further effects, faults, robots and seeds; statistics over many campaigns
    "tests/numeric/test_data_check.py::test_a_fault_of_the_second_plant_is_told": 9,
    "tests/numeric/second_plant/test_cases.py::test_a_large_effect_is_seen_and_no_monster": 20,
    **{f"tests/numeric/second_plant/test_loop.py::test_a_hundred_diagnoses_end[{part}": 65 for part in range(12)},
    **{f"tests/numeric/second_plant/test_loop_by_api.py[{machine}": 60 for machine in range(6)},
    "tests/numeric/second_plant/test_play.py::test_backlash_is_named_with_its_width": 15,
    "tests/numeric/second_plant/test_play.py::test_no_other_machine_has_play": 20,
    "tests/numeric/second_plant/test_scoring.py::test_a_fair_sample_goes_through": 26,
    "tests/numeric/test_channel_timing.py::test_lags_are_found_within_their_uncertainty": 8,
    "tests/numeric/test_drift_in_stored_estimates.py::test_the_drift_is_found_and_the_other_seven_are_quiet": 13,
    "tests/numeric/test_foreign_inertia.py::test_named_effects_mend_the_inertia": 9,
    "tests/numeric/test_foreign_machines.py::test_what_a_foreign_machine_hides_is_found": 25,
    "tests/numeric/test_free_motion.py::test_standard_deviations_keep_what_they_promise": 6,
    "tests/numeric/test_payload.py::test_free_motions_tell_the_payload[0.0": 16,
    "tests/numeric/test_free_motion.py::test_the_spread_grows_with_what_the_model_lacks[0.0]": 18,
    "tests/numeric/test_logs.py::test_a_nominal_model_that_is_quite_wrong_is_no_harm": 24,
    "tests/numeric/test_payload.py::test_a_payload_of_another_plant": 46,
    "tests/numeric/test_payload.py::test_friction_that_changed_is_told_as_no_load": 30,
    "tests/numeric/test_robot_type.py::test_the_tenth_robot_needs_a_third_of_the_sweeps[True": 20,
    "tests/numeric/test_makers_robots.py::test_from_a_makers_urdf_to_its_inertia": 6,
    "tests/numeric/test_planned_confidence.py::test_a_campaign_to_a_confidence_keeps_what_its_plan_promises": 5,
    "tests/numeric/test_planned_confidence.py::test_the_fewer_sweeps_know_inertia_as_well": 5,
    # the seeds of tests in virtual time, in other processes
    **{
        f"tests/virtual_time/test_nothing_moves_unasked.py::test_a_promise[{promise}": 45
        for promise in (
            "a stop ends what",
            "a stop outlives",
            "a release",
            "a stop reaches",
            "an abort",
            "a missing",
            "a pause",
            "nothing moves",
            "the death",
            "one service",
            "a stop ends approvals",
            "nothing goes on",
            "a stop does not wait",
        )
    },
    "tests/virtual_time/test_determinism.py::test_another_process_repeats_each_seed[modbus": 40,
    "tests/virtual_time/test_determinism.py::test_another_process_repeats_each_seed[sequences-100": 200,
    # that the search finds what is planted; on CANopen the first tier shows it
    "tests/virtual_time/test_planted_faults.py::test_a_fault_of_the_drivers_is_found[modbus": 50,
    "tests/virtual_time/test_planted_faults.py::test_faults_of_the_service_are_found": 200,
    # how much, not whether
    "tests/benchmarks/test_ratios.py::test_no_ratio_is_much_worse": 40,
}


class Name(NamedTuple):
    """What a test is called by: its file, its function, the beginning of its parameters."""

    file: str
    function: str
    parameters: str


def name_of(nodeid: str) -> Name:
    """Of a test, or of a line of `LONG`, where function and parameters may be missing."""
    called, _, parameters = nodeid.partition("[")
    file, _, function = called.partition("::")
    return Name(file, function.rpartition("::")[2], parameters.removesuffix("]"))


def named_by(entry: str, test: Name) -> bool:
    """Whether a line of `LONG` or `SHORT` names this test."""
    file, function, parameters = name_of(entry)
    return file == test.file and function in ("", test.function) and test.parameters.startswith(parameters)


def entry_of(nodeid: str) -> str | None:
    """Which line of `LONG` a test falls under: the first that names it, unless `SHORT` does."""
    test = name_of(nodeid)
    named = [entry for entry in _of_file().get(test.file, ()) if named_by(entry, test)]
    return None if any(entry in SHORT for entry in named) else next(iter(named), None)


def part_of(nodeid: str) -> int | None:
    """Its part of the second tier; None for the first."""
    entry = entry_of(nodeid)
    return None if entry is None else parts()[entry]


@cache
def _of_file() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for entry in (*LONG, *SHORT):
        found.setdefault(name_of(entry).file, []).append(entry)
    return found


@cache
def parts() -> dict[str, int]:
    """The part of each line of `LONG`: the most costly first, each to the part that has the least so far."""
    costs = dict.fromkeys(range(1, PARTS + 1), 0.0)
    found: dict[str, int] = {}
    for entry in sorted(LONG, key=lambda entry: (-LONG[entry], entry)):
        found[entry] = part = min(costs, key=lambda part: (costs[part], part))
        costs[part] += LONG[entry]
    return found
