"""Contact laws: random problems, their laws checked one by one in NumPy and against a long proximal iteration."""

import jax
import numpy as np
import pytest

from mjx_starleth.contact import ContactProblem, solve_contacts

COUNT = 200
SWEEPS = 60  # far more than a step takes: here the fixed point is examined, not the speed
LAW = 2e-4  # m/s, float32 at velocities of 1 m/s


def random_problems(seed: int, stiff_legs: float = 1.0):
    """Legs of 0.3 to 5 kg under a 27 kg torso; stiff_legs scales their own mobility, 0 is one rigid body."""
    rng = np.random.default_rng(seed)
    corners = np.array([[0.25, 0.18, -0.4], [0.25, -0.18, -0.4], [-0.25, 0.18, -0.4], [-0.25, -0.18, -0.4]])
    root = np.zeros((COUNT, 4, 6, 3))
    scale = np.concatenate([np.full(3, 27.0), [0.8, 1.2, 1.4]]) ** -0.5
    for k in range(COUNT):
        for i, r in enumerate(corners + rng.normal(size=(4, 3)) * 0.05):
            skew = np.array([[0, -r[2], r[1]], [r[2], 0, -r[0]], [-r[1], r[0], 0]])
            root[k, i] = scale[:, None] * np.concatenate([np.eye(3), skew])
    a = rng.normal(size=(COUNT, 4, 3, 3))
    own = stiff_legs * (a @ a.transpose(0, 1, 3, 2) + 0.2 * np.eye(3))
    return ContactProblem(
        root=np.float32(root),
        own=np.float32(own),
        free_velocity=np.float32(rng.normal(size=(COUNT, 4, 3))),
        friction=np.float32(rng.uniform(0.2, 1.0, (COUNT, 4))),
        closed=np.float32(rng.uniform(size=(COUNT, 4)) < 0.8),
    )


@pytest.fixture(scope="module")
def solver():
    return jax.jit(jax.vmap(lambda p, guess: solve_contacts(p, guess, SWEEPS)))


def velocities(p: ContactProblem, impulse):
    p = ContactProblem(*(np.asarray(x, float) for x in p))
    momentum = np.einsum("kiab,kib->ka", p.root, impulse)
    own = np.einsum("kiab,kib->kia", p.own, impulse)
    return p.free_velocity + np.einsum("kiab,ka->kib", p.root, momentum) + own


@pytest.mark.parametrize("stiff_legs", [1.0, 0.05])
def test_each_law_holds(solver, stiff_legs):
    p = random_problems(1, stiff_legs)
    impulse, residual = (np.asarray(x, float) for x in solver(p, np.zeros((COUNT, 4, 3), np.float32)))
    closed = p.closed > 0
    v, normal, tangent = velocities(p, impulse), impulse[..., 2], np.linalg.norm(impulse[..., :2], axis=-1)
    assert not impulse[~closed].any()
    assert (normal >= 0).all() and (v[..., 2][closed] > -LAW).all()
    pressed = closed & (normal > 1e-4)
    assert pressed.sum() > COUNT
    assert np.abs(v[..., 2][pressed]).max() < LAW
    assert (tangent <= p.friction * normal * (1 + 1e-5) + 1e-7).all()
    slides = pressed & (np.linalg.norm(v[..., :2], axis=-1) > 10 * LAW)
    assert slides.sum() > 50 and (pressed & ~slides).sum() > 30
    speed = np.linalg.norm(v[..., :2], axis=-1, keepdims=True)
    opposed = impulse[..., :2] + (p.friction * normal)[..., None] * v[..., :2] / np.maximum(speed, 1e-9)
    assert np.abs(opposed[slides]).max() < 2e-3 * normal.max()
    assert residual.max() < 1e-4


def test_against_a_long_proximal_iteration(solver):
    """Where the solution is unique (separate, mobile legs) both methods must find the same impulses."""
    p = random_problems(2)
    found, _ = solver(p, np.zeros((COUNT, 4, 3), np.float32))
    w = np.einsum("kiab,kjac->kibjc", *(np.asarray(p.root, float),) * 2)
    for i in range(4):
        w[:, i, :, i] += p.own[:, i]
    step = 0.5 / np.trace(w.reshape(COUNT, 12, 12), axis1=1, axis2=2)[:, None, None]
    impulse = np.zeros((COUNT, 4, 3))
    for _ in range(10_000):
        z = impulse - step * (p.free_velocity + np.einsum("kibjc,kjc->kib", w, impulse))
        n, t = np.maximum(z[..., 2:], 0), z[..., :2]
        t = t * np.minimum(1, p.friction[..., None] * n / np.maximum(np.linalg.norm(t, axis=-1, keepdims=True), 1e-12))
        impulse = np.concatenate([t, n], -1) * p.closed[..., None]
    assert np.abs(found - impulse).max() < 1e-3 * np.abs(impulse).max()


def test_the_residual_tells_how_far_it_is(solver):
    p = random_problems(3)
    zero = np.zeros((COUNT, 4, 3), np.float32)
    after = lambda n: jax.jit(jax.vmap(lambda q, g: solve_contacts(q, g, n)))(p, zero)  # noqa: E731
    by_sweeps = [np.asarray(after(n)[1]) for n in (1, 3, 9)]
    assert by_sweeps[0].max() > 10 * by_sweeps[1].max() > 0
    assert by_sweeps[2].max() < 1e-3
    _, again = solver(p, solver(p, zero)[0])
    assert np.asarray(again).max() < 1e-4


def test_one_rigid_body_on_four_feet_converges(solver):
    """W is singular, the impulses are not unique, and a Jacobi iteration over four feet diverges."""
    p = random_problems(4, stiff_legs=1e-4)
    _, residual = solver(p, np.zeros((COUNT, 4, 3), np.float32))
    scale = np.abs(p.free_velocity).max() * 27
    assert np.isfinite(residual).all() and np.median(residual) < 1e-3 * scale
