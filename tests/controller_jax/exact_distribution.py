"""Eq. 6 solved exactly in float64: least squares with inequalities, as NNLS (Lawson and Hanson 1974).

Written from eq. 6, without the package's formulation; every solution is checked by its KKT conditions.
"""

from typing import NamedTuple

import numpy as np
from scipy.optimize import nnls

KKT_TOLERANCE = 1e-6  # relative to the largest gradient or force in the problem


class Problem(NamedTuple):
    """One instance in plain NumPy."""

    r: np.ndarray  # (4, 3) torso origin to feet, control frame, m
    J: np.ndarray  # (4, 3, 3)
    weight_torque: np.ndarray  # (4, 3) N m
    load: np.ndarray  # (4,)
    wrench: np.ndarray  # (6,) N and N m


class Weights(NamedTuple):
    S: np.ndarray  # (6,)
    W: float
    friction: float
    minimal_normal: float
    torque_limits: np.ndarray  # (4, 3, 2) N m


def net_wrench(p: Problem, force: np.ndarray) -> np.ndarray:
    return np.concatenate([force.sum(0), np.cross(p.r, force).sum(0)])


def cost(w: Weights, p: Problem, force: np.ndarray) -> float:
    """Eq. 6; the regulariser of a partly loaded leg is divided by its load."""
    standing = p.load > 0
    e = net_wrench(p, force) - p.wrench
    return float(w.S @ e**2 + w.W * ((force[standing] ** 2).sum(1) / p.load[standing]).sum())


def violation(w: Weights, p: Problem, force: np.ndarray) -> tuple[float, float]:
    """Largest violation of the friction pyramid and minimal normal force, N, and of the torque limits, N m."""
    standing = p.load > 0
    f = force[standing]
    cone = np.abs(f[:, :2]).max(1) - w.friction * f[:, 2]
    normal = w.minimal_normal * p.load[standing] - f[:, 2]
    torque = (p.weight_torque - np.einsum("lij,li->lj", p.J, force))[standing]
    limits = w.torque_limits[standing]
    beyond = np.maximum(torque - limits[..., 1], limits[..., 0] - torque)
    return float(max(cone.max(), normal.max())), float(beyond.max())


def solve(w: Weights, p: Problem) -> np.ndarray | None:
    """Optimal forces (4, 3), or None if no forces satisfy the limits."""
    legs = np.flatnonzero(p.load > 0)
    n = 3 * len(legs)
    wrench = np.zeros((6, n))
    rows, least = [], []
    for k, leg in enumerate(legs):
        columns = slice(3 * k, 3 * k + 3)
        for axis in range(3):
            unit = np.eye(3)[axis]
            wrench[:, 3 * k + axis] = np.concatenate([unit, np.cross(p.r[leg], unit)])
        own = [([0.0, 0.0, 1.0], w.minimal_normal * p.load[leg])]
        own += [([a, b, w.friction], 0.0) for a, b in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        for j in range(3):
            column, weight = p.J[leg][:, j], p.weight_torque[leg, j]
            low, high = w.torque_limits[leg, j]
            own += [(-column, low - weight), (column, weight - high)]
        for row, bound in own:
            full = np.zeros(n)
            full[columns] = row
            rows.append(full)
            least.append(bound)
    G, h = np.array(rows), np.array(least)
    regularizer = np.sqrt(w.W / np.repeat(p.load[legs], 3))
    E = np.vstack([np.sqrt(w.S)[:, None] * wrench, np.diag(regularizer)])
    f = np.concatenate([np.sqrt(w.S) * p.wrench, np.zeros(n)])
    x = _least_squares_with_inequalities(E, f, G, h)
    if x is None:
        return None
    force = np.zeros((4, 3))
    force[legs] = x.reshape(-1, 3)
    return force


def _least_squares_with_inequalities(E, f, G, h) -> np.ndarray | None:
    """min |E x - f| subject to G x >= h."""
    Q, R = np.linalg.qr(E)
    free = np.linalg.solve(R, Q.T @ f)
    Gy = np.linalg.solve(R.T, G.T).T
    hy = h - G @ free
    scale = max(1.0, np.abs(hy).max())
    M = np.vstack([Gy.T, hy / scale])
    target = np.zeros(len(M))
    target[-1] = 1.0
    multipliers, _ = nnls(M, target, maxiter=2000)
    residual = M @ multipliers - target
    if abs(residual[-1]) < 1e-12:
        return None
    x = free - np.linalg.solve(R, residual[:-1] / residual[-1] * scale)
    pressing = -multipliers / residual[-1] * scale
    if (h - G @ x).max() > 1e-6 * scale:
        return None
    _check_kkt(E, f, G, h, x, pressing)
    return x


def _check_kkt(E, f, G, h, x, pressing) -> None:
    gradient = E.T @ (E @ x - f)
    size = 1.0 + np.abs(gradient).max() + np.abs(G.T * pressing).max()
    slack = G @ x - h
    assert np.abs(gradient - G.T @ pressing).max() < KKT_TOLERANCE * size
    assert pressing.min() >= 0.0 and slack.min() > -KKT_TOLERANCE * (1.0 + np.abs(h).max())
    assert np.abs(pressing * slack).max() < KKT_TOLERANCE * size * (1.0 + np.abs(h).max())
