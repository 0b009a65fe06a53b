"""The population axis lives here and nowhere else: vmap inside a chunk, chunks in turn, chunks over devices.

A chunk is the unit that is compiled. Its size does not depend on the number of devices, so the arithmetic of a
member does not either: 1, 2 or 4 devices give the same bits.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import AxisType, NamedSharding, PartitionSpec

CHUNK = 16  # environments per device whose working set stays in cache (README, `starleth bench`)


def device_mesh(devices: Sequence[jax.Device] | None = None) -> jax.sharding.Mesh:
    """A one-axis mesh 'members' over the given devices (default: all of this process)."""
    devices = list(devices or jax.local_devices())
    return jax.make_mesh((len(devices),), ("members",), axis_types=(AxisType.Auto,), devices=devices)


def batched(
    function: Callable[..., Any], mesh: jax.sharding.Mesh, chunk: int = CHUNK
) -> Callable[[Any, Any], Any]:
    """`function(shared, member) -> output` over a leading member axis, padded to whole chunks per device.

    Returns `run(shared, members) -> outputs`; `members` and `outputs` are pytrees with a leading axis of any
    length, as NumPy arrays on the way out. One program is compiled per number of chunks per device.
    """
    width = mesh.devices.size
    members_spec = PartitionSpec("members")

    def on_device(shared, members):
        chunks = jax.tree.map(lambda x: x.reshape(-1, chunk, *x.shape[1:]), members)
        outputs = jax.lax.map(lambda one: jax.vmap(lambda m: function(shared, m))(one), chunks)
        return jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), outputs)

    program = jax.jit(
        jax.shard_map(
            on_device,
            mesh=mesh,
            in_specs=(PartitionSpec(), members_spec),
            out_specs=members_spec,
            check_vma=False,
        )
    )
    sharded, replicated = NamedSharding(mesh, members_spec), NamedSharding(mesh, PartitionSpec())

    def run(shared: Any, members: Any) -> Any:
        count = len(jax.tree.leaves(members)[0])
        padded = -(-count // (chunk * width)) * chunk * width
        spread = jax.tree.map(lambda x: jax.device_put(_pad(np.asarray(x), padded), sharded), members)
        outputs = program(jax.device_put(shared, replicated), spread)
        return jax.tree.map(lambda x: np.asarray(x)[:count], outputs)

    return run


def _pad(array: np.ndarray, length: int) -> np.ndarray:
    """Repeat the last member up to `length`: a member that is known to run."""
    return np.concatenate([array, np.repeat(array[-1:], length - len(array), axis=0)])


def in_slices(run: Callable[[Any, Any], Any], shared: Any, members: Any, size: int) -> Any:
    """`run` over slices of the member axis, so that memory is bounded whatever the number of members."""
    count = len(jax.tree.leaves(members)[0])
    parts = []
    for start in range(0, count, size):
        part = jax.tree.map(lambda x, a=start: x[a : a + size], members)
        length = len(jax.tree.leaves(part)[0])
        whole = jax.tree.map(lambda x: _pad(np.asarray(x), size), part)
        parts.append(jax.tree.map(lambda x, n=length: x[:n], run(shared, whole)))
    return jax.tree.map(lambda *pieces: np.concatenate(pieces), *parts) if parts else None


def split_keys(key: jax.Array, count: int) -> jax.Array:
    """One key per member as raw uint32 data (NumPy-friendly)."""
    return jnp.asarray(jax.random.key_data(jax.random.split(key, count)))
