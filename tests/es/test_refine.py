"""Gradient refinement against problems whose solution is known in closed form."""

import numpy as np
import pytest
from es_problems import space

from es import RefineSettings, refine

CENTRE = np.array([0.3, 1.5, 3.0, 0.0])  # the third is outside the box [-1, 2]
OPTIMUM = np.array([0.3, 1.5, 2.0, 0.0])
STIFFNESS = np.array([1.0, 10.0, 5.0, 3.0])
REACHED = 3e-3  # a thousandth of the range of 3
SETTINGS = RefineSettings(steps=100)


def costs(x):
    return np.sum(STIFFNESS * (np.asarray(x, np.float64) - CENTRE) ** 2, -1)


def slope(x, step):
    return 2.0 * STIFFNESS * (np.asarray(x, np.float64) - CENTRE)


def test_it_finds_the_optimum_on_the_bound():
    box = space(initial=0.0)
    found = refine(slope, costs, box, box.initial, SETTINGS)
    np.testing.assert_allclose(found.best, OPTIMUM, atol=REACHED)
    assert found.best[2] == 2.0  # on the bound, not near it
    assert found.improved and found.best_cost == costs(found.best)
    course = [found.initial_cost, *(step.cost for step in found.history)]
    assert course == sorted(course, reverse=True)


def test_slopes_of_an_approximation_lower_the_true_cost_as_far_as_they_point_down():
    """The approximation's optimum is off by 0.1: the true cost decides, so the descent ends between the two."""
    box, off = space(initial=-0.5), 0.1
    found = refine(lambda x, step: slope(np.asarray(x) + off, step), costs, box, box.initial, SETTINGS)
    assert costs(found.best) < costs(OPTIMUM - off) - 0.01
    assert found.best_cost < 0.05 * (found.initial_cost - costs(OPTIMUM)) + costs(OPTIMUM)


def test_it_never_returns_anything_worse_than_it_was_given():
    box = space()
    found = refine(lambda x, step: -slope(x, step), costs, box, box.initial, RefineSettings(steps=40))
    assert not found.improved
    assert found.best.tobytes() == box.initial.tobytes()
    assert found.best_cost == found.initial_cost == costs(box.initial)
    assert len(found.history) == 10  # its patience


def test_a_wall_of_nan_is_not_entered():
    wall = 1.0
    box = space(initial=0.0)
    walled = lambda x: np.where(x[:, 1] < wall, costs(x), np.nan)  # noqa: E731
    found = refine(slope, walled, box, box.initial, SETTINGS)
    assert found.best[1] < wall
    in_front = costs(np.array([OPTIMUM[0], wall, *OPTIMUM[2:]]))
    assert found.best_cost < in_front + 0.5 * (found.initial_cost - in_front)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 0.0])
def test_a_slope_that_says_nothing_moves_nothing(bad: float):
    box = space()
    found = refine(lambda x, step: np.full(4, bad), costs, box, box.initial, SETTINGS)
    assert not found.improved and found.best_cost == costs(box.initial)


def test_an_enormous_slope_moves_no_further_than_a_ladder_s_longest_rung():
    box, tried = space(), []

    def kept(x):
        tried.append(x)
        return costs(x)

    refine(
        lambda x, step: np.array([1e20, 0.0, 0.0, 0.0]), kept, box, box.initial, RefineSettings(steps=1, length=0.01)
    )
    # two lengths of the range of 3
    assert np.abs(tried[1] - box.initial).max() == pytest.approx(0.06, rel=1e-4)


def test_a_descent_goes_on_to_the_same_bits():
    box, kept = space(initial=0.0), []
    whole = refine(slope, costs, box, box.initial, RefineSettings(steps=30), kept.append)
    again = refine(slope, costs, box, box.initial, RefineSettings(steps=30), resumed=kept[11])
    assert again.best.tobytes() == whole.best.tobytes() and again.history == whole.history


def test_what_cannot_be_refined_is_refused():
    box = space()
    with pytest.raises(ValueError, match="not finite"):
        refine(slope, lambda x: np.full(len(x), np.nan), box, box.initial, SETTINGS)
    with pytest.raises(ValueError, match=r"'p1'.*high bound 2"):
        refine(slope, costs, box, np.array([0.0, 5.0, 0.0, 0.0]), SETTINGS)
    with pytest.raises(ValueError, match="4 derivatives"):
        refine(lambda x, step: np.zeros(3), costs, box, box.initial, SETTINGS)
