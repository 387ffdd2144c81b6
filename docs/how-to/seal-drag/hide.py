import sys
from pathlib import Path

import numpy as np

from service.diagnosis.rows.signals import in_frequency
from service.diagnosis.sensitivity import expected
from service.identification.design.diagnosis_sweeps import full_design
from service.model.configuration import read_robot
from service.store.files.bundle import write_bundle

robot, noise = read_robot(Path("config/robots/max100-class.yaml")), np.random.default_rng(5)
poses = np.array([[-2.0, -0.6, 0.4, 0, 0, 0], [0.0, 0.4, -0.7, 0, 0, 0], [2.0, 0.0, 0.0, 0, 0, 0]])
sweeps = [expected(one, one.spec.pose[0]) for one in full_design(robot, "joint_1", poses, sample_rate=250.0)]
for record in (sweep.recording for sweep in sweeps):
    (acceleration,) = in_frequency(record.velocity[None], 250.0)
    angle, rigid = record.position, 300.0 * acceleration + 200.0 * record.velocity
    seal = (60.0 + 20.0 * np.cos(angle) - 30.0 * np.sin(angle)) * np.sign(record.velocity)
    record.effort[:] = rigid + seal + noise.normal(0.0, 3.0, len(angle))
write_bundle(Path(sys.argv[1]), robot, sweeps)
