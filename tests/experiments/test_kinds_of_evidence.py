"""The evidence of the robot and of a rigid joint is asked alike: its parts go together and add up."""

from pathlib import Path

import numpy as np
import pytest
from rigid_bench import GEARED, bench_log

from experiments.effects import LIBRARY
from experiments.measurement.evidence.gather import gather, model_for
from experiments.measurement.evidence.log_evidence import Evidence
from experiments.measurement.evidence.states import states_of
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.noise_floor import noise_of
from experiments.model import nominal_model

SQUAT = Path(__file__).parents[1] / "data" / "squat_reference_1500ms.csv.gz"


@pytest.fixture(scope="module", params=[("drive", "body"), ("effort",)], ids=["robot", "rigid joint"])
def evidence(request) -> Evidence:
    rigid = request.param == ("effort",)
    log = bench_log(coulomb=0.35) if rigid else read_log(SQUAT)
    effects = GEARED if rigid else {"coulomb_friction": LIBRARY["coulomb_friction"]}
    found = gather(log, model_for(log, nominal_model()), effects, noise_of(log))
    assert tuple(part.name for part in found.parts) == request.param and found.rigid == rigid
    return found


def test_the_parts_add_up_to_what_a_fit_minimises(evidence) -> None:
    at, every = evidence.start(), np.ones(evidence.blocks, bool)
    left = sum((rest.residual**2 / rest.part.tau).sum() for rest in evidence.rests(at))
    assert evidence.chi2([at]).sum() == pytest.approx(left)
    assert evidence.weight().sum() == pytest.approx(sum(part.noise(every).sum() for part in evidence.parts))


def test_what_is_told_part_by_part_goes_with_the_part_s_rows_and_channels(evidence) -> None:
    at, step = evidence.start(), np.zeros((1, evidence.atoms.size))
    told = (evidence.rests(at), evidence.inputs(at), states_of(evidence, at), evidence.local_parts(at, step))
    for part, rest, inputs, states, local in zip(evidence.parts, *told, strict=True):
        shape, rows = part.used.shape, len(part.block)
        assert rest.part is part and rest.residual.shape == local.columns.shape[1:] == shape
        assert part.channels.shape == shape[1:]
        np.testing.assert_allclose(local.columns[-1], rest.residual / np.sqrt(part.tau))
        assert all(np.broadcast_shapes(state.shape, shape) == shape for state in states.values())
        for joint in np.broadcast_to(part.joint, part.channels.shape).ravel():
            assert {x.shape for x in inputs.beside(joint).values()} == {(rows,)}


def test_local_products_are_those_of_the_columns(evidence) -> None:
    """Of four directions, two at one joint: they share no replay; the others do."""
    at, atoms = evidence.start(), evidence.atoms
    column = atoms.of("coulomb_friction")[0]
    steps = np.zeros((4, atoms.size))
    here = [0, 0, 4, 7] if column.size > 1 else [0, 0, 0, 0]
    steps[range(4), [column.start + j for j in here]] = 0.01, 0.02, -0.01, 0.03
    width = len(steps) + len(evidence.coefficients(at)) + 1
    dense = np.zeros((evidence.blocks, width, width))
    for part in evidence.local_parts(at, steps):
        for b in range(evidence.blocks):
            rows = part.columns[:, part.block == b].reshape(len(part.columns), -1)
            dense[b][np.ix_(part.index, part.index)] += rows @ rows.T
    assert np.abs(dense[:, :4, :4]).max() > 0
    np.testing.assert_allclose(evidence.local(at, steps), dense, rtol=1e-9, atol=1e-9 * np.abs(dense).max())
