"""Which drive turns a joint on a bench: a rigid one, or one of the robot's series-elastic ones."""

from typing import Final

import numpy as np

from experiments.measurement.evidence.drive_log import has_drives
from experiments.measurement.logs.log import Log
from mjx_starleth.names import JOINTS
from mjx_starleth.numbers import load_numbers

_RIGID: Final = "rigid"


def drive_of(log: Log) -> str:
    """`rigid`, or the joint kind whose drive it is: what the log's JSON or the joint's name says, else the one whose
    spring gives the measured torque best."""
    if log.joint.drive == _RIGID or not has_drives(log):
        return _RIGID
    named = [kind for kind in JOINTS if kind == log.joint.drive or kind in log.joint.name.split("_")]
    if named:
        return named[0]
    deflection = log.joints("motor_position") - log.joints("joint_position")
    torque = log.joints("joint_torque")
    springs = load_numbers().drive.spring_stiffness
    return min(JOINTS, key=lambda kind: float(np.nansum((torque - getattr(springs, kind) * deflection) ** 2)))
