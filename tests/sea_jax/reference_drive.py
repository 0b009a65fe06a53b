"""The oracle: one series-elastic drive in NumPy and SciPy, float64, sharing no code with sea_jax.

Between two samples of the current loop the equations of winding, rotor and spring are linear for a given sign of
friction and side of the spring, so matrix exponentials solve them exactly. Signs and sides are looked at every
10 us, ten times as often as the current loop runs.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import expm

LOOKS = 10  # per current-loop period


@dataclass
class ReferenceDrive:
    """One drive of plain numbers; `run` plays commands on a given motion of its link."""

    numbers: dict
    control: float = 2.5e-3
    velocity: float = 0.5e-3
    current: float = 0.1e-3
    exponentials: dict = field(default_factory=dict)

    def linear_system(self, slip: int, stopped: bool) -> np.ndarray:
        """Rates of [I, w, theta, q, qd, qdd, V, 1]; slip 0: the rotor is stuck."""
        n = self.numbers
        k, d = (n["stop_k"], n["stop_d"]) if stopped else (n["k"], n["d"])
        ratio, inertia = n["N"], n["inertia"] * n["N"]
        a = np.zeros((8, 8))
        a[0, [0, 1, 6]] = np.array([-n["R"], -n["Ke"] * ratio, 1.0]) / n["L"]
        if slip:
            a[1, [0, 1, 2, 3, 4, 7]] = (
                np.array([n["K"], -n["c1"] * ratio - d / ratio, -k / ratio, k / ratio, d / ratio, -slip * n["c0"]])
                / inertia
            )
        a[2, 1] = a[3, 4] = a[4, 5] = 1.0
        return a

    def step(self, x: np.ndarray, slip: int, stopped: bool) -> np.ndarray:
        key = (slip, stopped)
        if key not in self.exponentials:
            self.exponentials[key] = expm(self.linear_system(*key) * self.current / LOOKS)
        return self.exponentials[key] @ x

    def stopped(self, x: np.ndarray) -> bool:
        return self.numbers["side"] * (x[2] - x[3]) < 0

    def torque(self, x: np.ndarray) -> float:
        n = self.numbers
        k, d = (n["stop_k"], n["stop_d"]) if self.stopped(x) else (n["k"], n["d"])
        return k * (x[2] - x[3]) + d * (x[1] - x[4])

    def move(self, x: np.ndarray, slip: int) -> tuple[np.ndarray, int]:
        """One current-loop period at a held voltage."""
        n = self.numbers
        for _ in range(LOOKS):
            push = n["K"] * x[0] - self.torque(x) / n["N"]
            if slip == 0 and abs(push) > n["c0"]:
                slip = int(np.sign(push))
            x = self.step(x, slip, self.stopped(x))
            if slip and x[1] * slip < 0.0:
                x[1], slip = 0.0, 0
        return x, slip

    def wanted(self, command: dict, x: np.ndarray) -> float:
        n, torque = self.numbers, self.torque(x)
        if "torque" in command:
            w = n["gain"] * (command["torque"] - torque) + n["ff"] * x[4]
        else:
            w = n["a"] * (command["position"] - x[2]) + n["b"] * (command["position"] - x[3]) - n["c"] * x[4]
        bound = min(n["power"] / max(abs(torque), 1e-9), n["speed"])
        return min(max(w, -bound), bound)

    def run(self, commands: list[dict], link: np.ndarray, theta: float) -> dict[str, np.ndarray]:
        """From rest with nothing in the integrators; link (T, 3): q, qd, qdd of each period."""
        n = self.numbers
        x = np.zeros(8)
        x[2], x[7] = theta, 1.0
        velocity_sum, current_sum, slip = 0.0, 0.0, 0
        samples = []
        for command, motion in zip(commands, link, strict=True):
            x[3:6] = motion
            samples.append([x[2], x[1], x[0], self.torque(x)])
            wanted = self.wanted(command, x)
            for tick in range(round(self.control / self.current)):
                if tick % round(self.velocity / self.current) == 0:
                    error = n["N"] * (wanted - x[1])
                    velocity_sum = np.clip(
                        velocity_sum + n["v_ki"] * self.velocity * error, -n["v_clamp"], n["v_clamp"]
                    )
                    asked = np.clip(n["v_kp"] * error + velocity_sum, -n["I_max"], n["I_max"])
                error = asked - x[0]
                current_sum = np.clip(current_sum + n["i_ki"] * self.current * error, -n["i_clamp"], n["i_clamp"])
                x[6] = np.clip(n["i_kp"] * error + current_sum, -n["bus"], n["bus"])
                x, slip = self.move(x, slip)
        return dict(zip(("theta", "w", "I", "torque"), np.array(samples).T, strict=True))


def nominal(robot: dict, joint: str, leg: str = "LF") -> dict:
    """The reference's plain numbers from the robot's file."""
    drive, loops = robot["drive"], robot["loops"]
    v, i, position = loops["velocity_pi"], loops["current_pi"], loops["position_mode"][joint]
    return {
        "N": drive["gear_ratio"], "K": drive["torque_constant"], "Ke": drive["back_emf_constant"],
        "R": drive["resistance"], "L": drive["inductance"], "inertia": drive["motor_inertia"],
        "bus": drive["bus_voltage"], "I_max": drive["current_limit"],
        "c0": drive["friction_coulomb"], "c1": drive["friction_viscous"],
        "k": drive["spring_stiffness"][joint], "d": drive["spring_damping"][joint],
        "side": (1 if leg[1] == "F" else -1) if joint == "KFE" else 0,
        "stop_k": drive["knee_stop_stiffness"], "stop_d": drive["knee_stop_damping"],
        "v_kp": v["kp"], "v_ki": v["ki"], "v_clamp": v["integrator_limit"],
        "i_kp": i["kp"], "i_ki": i["ki"], "i_clamp": i["integrator_limit"],
        "gain": loops["torque_mode"]["gain"][joint], "ff": loops["torque_mode"]["velocity_feedforward"],
        "a": position["a"], "b": position["b"], "c": position["c"],
        "speed": loops["gear_speed_limit"], "power": loops["power_limit"],
    }  # fmt: skip
