"""Named parameters: the vector view keeps names, order and bounds, and refusals say which name and which bound."""

import numpy as np
import pytest

from es import Parameter, ParameterSpace

JUMP = ParameterSpace(
    (
        Parameter("knot", "m", 0.22, 0.55, 0.4),
        Parameter("damping", "N s/m", 0.0, 400.0, 120.0, scale=100.0),
    )
)


def test_named_values_survive_float32_at_the_bounds():
    # float32(0.55) > 0.55: exporting it as it is would write a value out of its own bounds
    vector = JUMP.vector({"damping": 400.0, "knot": 0.55})
    named = JUMP.named(vector)
    assert named == {"knot": 0.55, "damping": 400.0}
    assert JUMP.vector(named).tobytes() == vector.tobytes()


def test_a_scale_sets_the_length_of_a_normalised_unit():
    np.testing.assert_allclose(JUMP.normalise(JUMP.initial), [(0.4 - 0.22) / 0.33, 1.2], rtol=1e-6)
    np.testing.assert_allclose(JUMP.normalised_high, [1.0, 4.0], rtol=1e-6)


def test_denormalising_undoes_normalising_and_stays_in_bounds():
    y = np.random.default_rng(0).uniform(0.0, JUMP.normalised_high, (500, 2)).astype(np.float32)
    x = JUMP.denormalise(np.concatenate([y, np.zeros((1, 2)), JUMP.normalised_high[None, :]]))
    assert x.dtype == np.float32
    assert np.all(x >= np.float32(JUMP.low)) and np.all(x <= np.float32(JUMP.high))
    # float32 rounding of x, carried back: 4 ulp of the largest value over the range
    np.testing.assert_allclose(JUMP.normalise(x[:500]), y, atol=4 * 2**-24 * 4)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("k", "m", 1.0, 0.0, 0.5), ["'k'", "low 1", "high 0"]),
        (("k", "m", 1.0, 1.0 + 1e-9, 1.0), ["'k'", "low 1"]),  # one and the same float32
        (("k", "m", 0.0, 1.0, 1.5), ["'k'", "initial guess 1.5", "above its high bound 1 m"]),
        (("k", "m", 0.0, 1.0, -0.5), ["'k'", "initial guess -0.5", "below its low bound 0 m"]),
        (("k", "m", float("nan"), 1.0, 0.5), ["'k'", "low", "finite"]),
        (("k", "m", 0.0, "1", 0.5), ["'k'", "high", "finite number"]),
        (("k", "m", 0.0, 1.0, 0.5, 0.0), ["'k'", "scale", "positive"]),
    ],
)
def test_a_parameter_that_makes_no_sense_is_refused_by_name_and_bound(arguments, words):
    with pytest.raises(ValueError) as refusal:
        Parameter(*arguments)
    assert all(word in str(refusal.value) for word in words), refusal.value
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"knot": 0.4}, ["'damping' is missing"]),
        ({"knot": 0.4, "damping": 1.0, "gain": 2.0}, ["unknown parameter 'gain'", "knot, damping"]),
        ({"knot": 0.6, "damping": 1.0}, ["'knot'", "0.6", "high bound 0.55 m"]),
        ({"knot": float("inf"), "damping": 1.0}, ["'knot'", "finite"]),
    ],
)
def test_named_values_that_do_not_fit_are_refused(values, words):
    with pytest.raises(ValueError) as refusal:
        JUMP.vector(values)
    assert all(word in str(refusal.value) for word in words), refusal.value


def test_a_vector_that_does_not_fit_is_refused():
    with pytest.raises(ValueError, match="vector of 2 parameters"):
        JUMP.named(np.zeros(3))
    with pytest.raises(ValueError, match=r"'knot'.*low bound 0.22 m"):
        JUMP.named(np.array([0.1, 1.0], np.float32))
    with pytest.raises(ValueError, match="name 'knot' is used 2 times"):
        ParameterSpace((JUMP.parameters[0], JUMP.parameters[0]))
