"""Rows that no replay tells: where next to nothing decides which way the drives go.

A motor at the end of a supply that sags switches between its limits: a little earlier or later, and its current a row
on is another one by amperes. Whether a replay hits it says nothing of the effects in it. The links' noise moves such
rows far, or a hundredth more and less of the effects does, and not to both sides alike.
"""

import numpy as np
from scipy.ndimage import maximum_filter1d

from experiments.measurement.evidence.drive_evidence import DriveEvidence
from experiments.measurement.evidence.log_evidence import Point
from experiments.measurement.evidence.robot_evidence import RobotEvidence

FAR = 10.0  # floors that a prediction moves by; in hops with a stiff supply one current in 10 000 does
REACH = 2  # rows to both sides
LITTLE = 0.01  # of the effects' strengths


def untold(drive: DriveEvidence, x: np.ndarray, shift: np.ndarray) -> np.ndarray:
    """Rows (rows, J, 3) whose prediction moves far for next to nothing, at atoms x (n,) and shift (J,)."""
    change = LITTLE * np.where(drive.atoms.strengths(), x, 0.0)
    clean, more, less = drive.predict(np.stack([x, x + change, x - change]), np.stack([shift] * 3))
    runs = [drive.play(drive.log, motion, x[None], shift[None])[0, : drive.rows] for motion in drive.renoised]
    moved = [np.abs(more + less - 2.0 * clean), *(np.abs(run - clean) for run in runs)]
    near = np.max(moved, 0) / drive.floor <= FAR  # what is no number is not near
    return maximum_filter1d(~near, 2 * REACH + 1, axis=0)


def without_untold(log: RobotEvidence, at: Point) -> RobotEvidence:
    """The log without the rows that its replay at a point does not tell; the log itself, with all that it remembers,
    where there are none."""
    rows = untold(log.drive, at.x, at.shift)
    return log.without(rows) if rows.any() else log
