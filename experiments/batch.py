"""The population axis lives here and in lanes.py: members of a chunk at once, chunks in turn, chunks over devices.

A chunk is the unit that is compiled, for one device. The CPU devices of a process are the same cores under several
names: there, one compiled program is run by as many threads as devices were asked for; every accelerator has its own
copy. So 1, 2 or 4 devices give the same bits. (One program over all devices, by shard_map, does not: with more than one
partition XLA orders its passes otherwise and fuses otherwise, and a fall makes of a last bit another cost.)
"""

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np
from jax.sharding import AxisType

from experiments.lanes import lanes

CHUNK = 8  # environments per device: float32 lanes of one AVX2 register (`starleth bench`)
ACCELERATOR_CHUNK = 512  # the same for a device with lanes to fill and a memory of its own


def device_mesh(devices: Sequence[jax.Device] | None = None) -> jax.sharding.Mesh:
    """A one-axis mesh 'members' over the given devices (default: all of this process)."""
    devices = list(devices or jax.local_devices())
    return jax.make_mesh((len(devices),), ("members",), axis_types=(AxisType.Auto,), devices=devices)


def local_mesh(cpu_devices: int | None = None) -> jax.sharding.Mesh:
    """So many CPU devices of this process (default: all), or every accelerator that it has."""
    devices = jax.local_devices()
    return device_mesh(devices[:cpu_devices] if devices[0].platform == "cpu" else devices)


def chunk_on(mesh: jax.sharding.Mesh, cpu_chunk: int) -> int:
    """Environments in one chunk of a mesh's devices."""
    return cpu_chunk if mesh.devices.flat[0].platform == "cpu" else max(cpu_chunk, ACCELERATOR_CHUNK)


def members_first(function: Callable[..., Any]) -> Callable[[Any, Any], Any]:
    """`jax.vmap` over members, for functions of libraries that are written for it."""
    return lambda shared, members: jax.vmap(lambda member: function(shared, member))(members)


def batched(
    function: Callable[..., Any],
    mesh: jax.sharding.Mesh,
    chunk: int = CHUNK,
    together: Callable[[Callable[..., Any]], Callable[[Any, Any], Any]] = lanes,
) -> Callable[[Any, Any], Any]:
    """`function(shared, member) -> output` over a leading member axis, padded to whole chunks.

    Returns `run(shared, members) -> outputs`; `members` and `outputs` are pytrees with a leading axis of any
    length, as NumPy arrays on the way out. One program is compiled, of one chunk, whatever that length.
    """
    devices = list(mesh.devices.flat)
    places = devices[:1] * len(devices) if devices[0].platform == "cpu" else devices
    program = jax.jit(together(function))
    compiled: dict[Any, dict[jax.Device, Any]] = {}
    lock = threading.Lock()  # a program may be wanted while it is being compiled ahead

    def programs(shared: Any, members: Any) -> dict[jax.Device, Any]:
        leaves, form = jax.tree.flatten((shared, members))
        key = form, tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        with lock:
            if key not in compiled:
                there = {place: jax.device_put((shared, members), place) for place in dict.fromkeys(places)}
                compiled[key] = {place: program.lower(*arguments).compile() for place, arguments in there.items()}
            return compiled[key]

    def run(shared: Any, members: Any) -> Any:
        count = len(jax.tree.leaves(members)[0])
        shared = jax.tree.map(np.asarray, shared)
        starts = range(0, count, chunk)
        chunks = [jax.tree.map(lambda x, a=a: _pad(np.asarray(x)[a : a + chunk], chunk), members) for a in starts]
        ready = programs(shared, chunks[0])

        waiting = iter(range(len(chunks)))  # whose next is one step of the interpreter: no chunk is taken twice

        def turn(place: jax.Device) -> dict[int, Any]:
            """Chunk after chunk of those that wait, on one device: a slow core takes fewer of them."""
            here = jax.device_put(shared, place)
            taken = iter(lambda: next(waiting, None), None)
            return {i: jax.tree.map(np.asarray, ready[place](here, jax.device_put(chunks[i], place))) for i in taken}

        with ThreadPoolExecutor(len(places)) as pool:
            done = {i: part for turns in pool.map(turn, places) for i, part in turns.items()}
        parts = [done[i] for i in range(len(chunks))]
        return jax.tree.map(lambda *pieces: np.concatenate(pieces)[:count], *parts)

    return run


def _pad(array: np.ndarray, length: int) -> np.ndarray:
    """Repeat the last member up to `length`: a member that is known to run."""
    return np.concatenate([array, np.repeat(array[-1:], length - len(array), axis=0)])


def in_slices(run: Callable[[Any, Any], Any], shared: Any, members: Any, size: int) -> Any:
    """`run` over slices of the member axis, so that memory is bounded whatever the number of members."""
    count = len(jax.tree.leaves(members)[0])
    slices = [jax.tree.map(lambda x, a=start: x[a : a + size], members) for start in range(0, count, size)]
    parts = [run(shared, part) for part in slices]
    return jax.tree.map(lambda *pieces: np.concatenate(pieces), *parts) if parts else None
