"""What one device runs at once."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from experiments.batch import ACCELERATOR_CHUNK, CHUNK, batched, chunk_on, local_mesh, members_first


@pytest.mark.parametrize(
    ("platform", "chunk"), [("cpu", CHUNK), ("gpu", ACCELERATOR_CHUNK), ("tpu", ACCELERATOR_CHUNK)]
)
def test_chunks_fit_the_device(platform: str, chunk: int) -> None:
    devices = np.array([SimpleNamespace(platform=platform)] * 2)
    assert chunk_on(SimpleNamespace(devices=devices), CHUNK) == chunk


@pytest.mark.parametrize("count", [1, 3, None])
def test_the_cpu_devices_asked_for_are_used_and_give_the_same_bits(count: int | None) -> None:
    mesh = local_mesh(count)
    assert mesh.devices.size == (count or len(jax.local_devices()))
    members = np.random.default_rng(0).normal(size=(23, 5)).astype(np.float32)
    run = batched(lambda shared, x: (x * x).sum() * shared, mesh, 4)
    alone = batched(lambda shared, x: (x * x).sum() * shared, local_mesh(1), 4)
    np.testing.assert_array_equal(run(np.float32(2.0), members), alone(np.float32(2.0), members))


def test_every_chunk_is_run_once_whichever_device_takes_it() -> None:
    seen: list[float] = []

    def noted(shared, member):
        jax.debug.callback(lambda x: seen.append(float(x)), member)
        return shared * member

    members = np.arange(10, dtype=np.float32)
    found = batched(noted, local_mesh(2), 2, members_first)(np.float32(3.0), members)
    jax.effects_barrier()
    np.testing.assert_array_equal(found, 3.0 * members)
    assert sorted(seen) == list(members)
