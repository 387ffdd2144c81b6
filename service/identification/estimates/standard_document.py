"""The standard parameters of an estimate as a document."""

from service.identification.estimates.standard_parameters import StandardParameters
from service.identification.model.physical_consistency import Ended
from service.model.results import standard as results
from service.model.robot import INERTIAL_NAMES, Robot


def standard_document(robot: Robot, standard: StandardParameters) -> results.StandardParameters:
    """Parameters of all links and motors of the robot, by name."""
    joints = robot.chain.joints
    count = 10 * len(joints)
    return results.StandardParameters(
        links={
            joint.link: dict(zip(INERTIAL_NAMES, values.tolist(), strict=True))
            for joint, values in zip(joints, standard.parameters[:count].reshape(-1, 10), strict=True)
        },
        motor_inertias={
            f"Jm({joint.name})": float(value) for joint, value in zip(joints, standard.parameters[count:], strict=True)
        },
    )


def physical_document(standard: StandardParameters) -> results.Physical:
    """`warning` where the search of the most probable robot did not converge."""
    warning = standard.ended.value if standard.ended is Ended.UNFINISHED else ""
    return results.Physical(deviation_in_std=standard.deviation).with_nonempty(warning=warning)
