"""Standard deviation of every sensor: from the log's JSON where it is known, else from the log itself."""

import numpy as np

from experiments.measurement.logs.log import Log

MAD_TO_STD = 1.4826
# a third difference of white noise has this standard deviation; what a joint does at 400 Hz it hardly sees
THIRD_DIFFERENCE = np.sqrt(20.0)
# used where a signal was neither described nor logged: the robot's usual sensors
USUAL = {
    "joint_position": 2e-4,
    "joint_velocity": 0.02,
    "motor_position": 5e-5,
    "motor_velocity": 0.01,
    "joint_torque": 0.05,
    "motor_current": 0.05,
    "base_position": 5e-4,
    "base_orientation": 5e-4,
    "base_linear_velocity": 0.01,
    "base_angular_velocity": 0.005,
    "base_acceleration": 0.05,
}
# velocities that are central differences of another signal where they were not logged, per unit of its own rate
DIFFERENTIATED = {
    "base_linear_velocity": ("base_position", 1.0),
    "base_angular_velocity": ("base_orientation", 2.0),
    "joint_velocity": ("joint_position", 1.0),
    "motor_velocity": ("motor_position", 1.0),
}


def noise_of(log: Log) -> dict[str, float]:
    """Noise by signal name."""
    known = dict(USUAL)
    for name, table in log.signals.items():
        estimate = estimated(table.values)
        if name in USUAL and estimate > 0:
            known[name] = estimate
    known |= {name: std for name, std in log.noise_std.items() if std > 0}
    for name, (source, factor) in DIFFERENTIATED.items():
        if name not in log.signals and source in log.signals:
            known[name] = factor * known[source] / (np.sqrt(2.0) * log.sample_period)
    return known


def estimated(values: np.ndarray) -> float:
    """White noise of a table (T, n): median over its columns of the robust size of third differences."""
    third = np.diff(values, 3, axis=0)
    third = third[:, np.isfinite(third).any(0)]
    if third.size == 0:
        return 0.0
    size = MAD_TO_STD * np.nanmedian(np.abs(third - np.nanmedian(third, 0)), 0) / THIRD_DIFFERENCE
    return float(np.median(size))
