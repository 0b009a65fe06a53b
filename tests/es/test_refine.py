"""Gradient refinement against problems whose solution is known in closed form."""

import numpy as np
import pytest
from es_problems import space

from es import RefineSettings, refine

CENTRE = np.array([0.3, 1.5, 3.0, 0.0])  # the third is outside the box [-1, 2]
OPTIMUM = np.array([0.3, 1.5, 2.0, 0.0])
STIFFNESS = np.array([1.0, 100.0, 10.0, 3.0])
# cosine decay ends the descent within a thousandth of the range of 3
REACHED = 3e-3


def quadratic(x):
    x = np.asarray(x, np.float64)
    return np.sum(STIFFNESS * (x - CENTRE) ** 2), 2.0 * STIFFNESS * (x - CENTRE)


def test_it_finds_the_optimum_on_the_bound():
    box = space(initial=0.0)
    found = refine(quadratic, box, box.initial, RefineSettings(steps=200, learning_rate=0.05))
    np.testing.assert_allclose(found.best, OPTIMUM, atol=REACHED)
    assert found.best[2] == 2.0  # on the bound, not near it
    assert found.improved and not found.gave_up
    assert found.best_cost == min(step.cost for step in found.history) == quadratic(found.best)[0]


def test_it_never_returns_anything_worse_than_it_was_given():
    box = space()
    climbs = lambda x: (quadratic(x)[0], -quadratic(x)[1])  # noqa: E731
    found = refine(climbs, box, box.initial, RefineSettings(steps=20))
    assert not found.improved
    assert found.best.tobytes() == box.initial.tobytes()
    assert found.best_cost == found.initial_cost == quadratic(box.initial)[0]


def test_a_wall_of_nan_is_backed_away_from():
    wall = 1.0

    def cost(x):
        value, slope = quadratic(x)
        return (value, slope) if x[1] < wall else (np.nan, np.full(4, np.nan))

    box = space(initial=0.0)
    found = refine(cost, box, box.initial, RefineSettings(steps=200, learning_rate=0.05, patience=10))
    assert any(step.failed for step in found.history)
    assert found.best[1] < wall
    # from x_1 = 0 most of what there is to gain in front of the wall is gained
    in_front = quadratic(np.array([OPTIMUM[0], wall, *OPTIMUM[2:]]))[0]
    assert found.best_cost < in_front + 0.2 * (found.initial_cost - in_front)


def test_a_gradient_that_is_never_finite_is_given_up_with_the_best_cost_seen():
    box = space()
    found = refine(lambda x: (1.0, np.array([np.inf, 0.0, 0.0, 0.0])), box, box.initial, RefineSettings(steps=50))
    assert found.gave_up and not found.improved and len(found.history) == 1


def test_an_enormous_gradient_moves_no_further_than_the_learning_rate():
    box = space()
    seen = []

    def cost(x):
        seen.append(x)
        return 1e20 * x[0], np.array([1e20, 0.0, 0.0, 0.0])

    refine(cost, box, box.initial, RefineSettings(steps=1, learning_rate=0.01))
    # Adam's first step is the learning rate in every coordinate with a slope; the range is 3
    np.testing.assert_allclose(seen[1] - seen[0], [-0.03, 0.0, 0.0, 0.0], rtol=1e-4, atol=1e-7)


def test_what_cannot_be_refined_is_refused():
    box = space()
    with pytest.raises(ValueError, match="not finite"):
        refine(lambda x: (np.nan, np.zeros(4)), box, box.initial, RefineSettings())
    with pytest.raises(ValueError, match=r"'p1'.*high bound 2"):
        refine(quadratic, box, np.array([0.0, 5.0, 0.0, 0.0]), RefineSettings())
    with pytest.raises(ValueError, match="4 derivatives"):
        refine(lambda x: (0.0, np.zeros(3)), box, box.initial, RefineSettings())
