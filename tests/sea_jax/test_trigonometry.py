"""Sine and cosine against NumPy's in double precision."""

import jax
import numpy as np
import pytest

from sea_jax.trigonometry import sine_cosine


@pytest.mark.parametrize("largest", [1.0, 100.0, 3000.0, 8000.0])
def test_sine_and_cosine_are_exact_to_single_precision(largest):
    angle = np.random.default_rng(0).uniform(-largest, largest, 100_000).astype(np.float32)
    sine, cosine = sine_cosine(angle)
    np.testing.assert_allclose(sine, np.sin(angle.astype(float)), atol=2e-7)
    np.testing.assert_allclose(cosine, np.cos(angle.astype(float)), atol=2e-7)


def test_quarters_of_a_turn_and_their_neighbours():
    turns = np.arange(-40, 41)[:, None] * np.pi / 4 + np.array([-1e-3, 0.0, 1e-3])
    angle = turns.astype(np.float32)
    sine, cosine = sine_cosine(angle)
    np.testing.assert_allclose(sine, np.sin(angle.astype(float)), atol=2e-7)
    np.testing.assert_allclose(cosine, np.cos(angle.astype(float)), atol=2e-7)


def test_slopes_are_those_of_sine_and_cosine():
    angle = np.linspace(-7.0, 7.0, 101, dtype=np.float32)
    slope = jax.vmap(jax.jacfwd(sine_cosine))(angle)
    np.testing.assert_allclose(slope[0], np.cos(angle.astype(float)), atol=2e-6)
    np.testing.assert_allclose(slope[1], -np.sin(angle.astype(float)), atol=2e-6)


def test_no_number_is_no_number():
    assert np.isnan(sine_cosine(np.float32(np.nan))).all()
