"""Members last is jax.vmap in another layout: the same numbers, whatever a function is made of."""

import jax
import jax.numpy as jnp
import numpy as np

from experiments.lanes import lanes

SHARED = (np.float32([[0.3, 0.1, 0.0], [0.2, -0.3, 0.1], [0.0, 0.4, 0.2]]), np.float32([0.0, 1.0, 2.0]))
SIZE = 5
MEMBERS = {
    "x": np.linspace(0.0, 2.0, SIZE, dtype=np.float32),
    "y": np.random.default_rng(0).normal(size=(SIZE, 3)).astype(np.float32),
}


def check(function) -> None:
    shared = jax.tree.map(jnp.asarray, SHARED)
    expected = jax.vmap(lambda member: function(shared, member))(MEMBERS)
    found = jax.jit(lanes(function))(SHARED, MEMBERS)
    assert jax.tree.structure(found) == jax.tree.structure(expected)
    for ours, theirs in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        assert ours.dtype == theirs.dtype and ours.shape == theirs.shape
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-6)


def test_shapes_and_elementwise_arithmetic():
    def function(shared, member):
        (a, b), x, y = shared, member["x"], member["y"]
        matrix = y[:, None] * b[None, :] + a
        return {
            "scalar and vector": x * b + jnp.where(x > 1.0, y, b),
            "bounds": (jnp.clip(y, -x, x), jnp.clip(b, 0.0, x), jnp.clip(y, -0.5, b)),
            "constants": (jnp.zeros(3), a[0], jnp.float32(2.0) * b),
            "axes": (matrix.T[::2], matrix.reshape(9)[1:7].reshape(2, 3), jnp.broadcast_to(y, (2, 3))),
            "joined": (jnp.concatenate([y, b]), jnp.stack([y, b], 1), jnp.stack([x, 2.0 * x]), jnp.split(y, 3)),
            "reduced": (matrix.max(1), matrix.sum(0), jnp.argmax(y), (y > 0.0).any(), jnp.cumsum(y)),
            "without a rule of its own": (a @ y, y @ y, jnp.sort(y), y.at[1].set(x), b[x.astype(jnp.int32)]),
        }

    check(function)


def test_loops_calls_and_derivatives():
    def step(a, x, carry, row):
        count, state = carry
        state = jnp.tanh(a @ jax.nn.relu(state) + row) * x
        return (count + 1, state), (state[0], row)

    def function(shared, member):
        (a, b), x, y = shared, member["x"], member["y"]
        rows = jnp.stack([b, y, b + y])
        start = (jnp.zeros((), jnp.int32), jnp.zeros(3))  # no member in the start, but in what follows
        forth = jax.lax.scan(lambda carry, row: step(a, x, carry, row), start, rows)
        back = jax.lax.scan(lambda carry, k: (carry + b[k] * x, k), x, jnp.arange(3), reverse=True)
        alone = jax.lax.scan(lambda carry, k: (carry + k, carry), 0.0, b)
        until = jax.lax.while_loop(lambda v: v < 3.0, lambda v: v + x + 0.5, x)
        slope = jax.jvp(lambda t: jax.lax.scan(lambda c, r: step(a, t, c, r), start, rows)[0][1], (x,), (1.0 + x,))
        return forth, back, alone, until, slope, jax.lax.cond(x > 1.0, lambda: y, lambda: b)

    check(function)
