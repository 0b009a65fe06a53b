"""Rows that no replay tells: where noise decides which way the drives go.

A motor at the end of a supply that sags switches between its limits: a little earlier or later, and its current a row
on is another one by amperes. Whether a replay hits it says nothing of the effects in it.
"""

from dataclasses import replace

import numpy as np
from scipy.ndimage import maximum_filter1d

from experiments.measurement.evidence.drive_evidence import DriveEvidence
from experiments.measurement.evidence.log_evidence import Point
from experiments.measurement.evidence.robot_evidence import RobotEvidence

FAR = 10.0  # floors that a prediction moves by; in hops with a stiff supply one current in 10 000 does
REACH = 2  # rows to both sides


def untold(drive: DriveEvidence, x: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Rows (rows, J, 3) whose prediction at atoms x (n,) and shift (J,) moves far with the links' noise."""
    asked = x[None], shift[None]
    clean = drive.predict(*asked)[0]
    runs = [drive.play(drive.log, motion, *asked)[0, : drive.rows] for motion in drive.renoised]
    away = np.max([np.abs(run - clean) for run in runs], 0) / drive.floor
    return maximum_filter1d(away > FAR, 2 * REACH + 1, axis=0)


def without_untold(log: RobotEvidence, at: Point) -> RobotEvidence:
    """The log without the rows that its replay at a point does not tell; the log itself, with all that it remembers,
    where there are none."""
    rows = untold(log.drive, at.x, at.shift)
    return replace(log, drive=replace(log.drive, used=log.drive.used * ~rows)) if rows.any() else log
