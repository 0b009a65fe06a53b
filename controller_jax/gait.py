"""Contact schedule of a periodic gait (V.A.1): when each leg is planned to stand and to swing.

Phases are fractions of the stride, legs LF RF LH RH. The full form has 9 numbers: touch-down and lift-off
of each leg and the stride duration. The reduced form has 6: cycle, two duty factors, three lags (FACTS 3.3).
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.types import Array

SHORTEST_SWING = 1e-3  # of the stride: a leg that never swings has a swing phase of zero, not 0 / 0


class ReducedGait(NamedTuple):
    """Symmetrical and asymmetrical gaits in six numbers; every field ()."""

    cycle_duration: Array  # s
    fore_duty: Array  # share of the stride a fore leg stands, 0..1
    hind_duty: Array  # the same of a hind leg
    fore_lag: Array  # RF after LF, share of the stride
    hind_lag: Array  # RH after LH
    pair_lag: Array  # LH after LF


class GaitPattern(NamedTuple):
    """The nine numbers. A leg with lift-off and touch-down at the same phase never leaves the ground."""

    stride_duration: Array  # () s
    touch_down: Array  # (4,) phase
    lift_off: Array  # (4,) phase


class LegPhases(NamedTuple):
    """Where each leg is in its plan; every field (4,)."""

    stance: Array  # 1.0 in planned stance, 0.0 in planned swing
    stance_phase: Array  # 0..1 through the stance, 1 during swing
    swing_phase: Array  # 0..1 through the swing, 0 during stance
    stance_duration: Array  # s
    swing_duration: Array  # s


def wrap(phase: Array) -> Array:
    """Phase into [0, 1); a tiny negative phase rounds to 1.0 in float32 and must become 0."""
    fraction = phase - jnp.floor(phase)
    return jnp.where(fraction >= 1.0, 0.0, fraction)


def full_pattern(gait: ReducedGait) -> GaitPattern:
    """The nine numbers of a reduced gait; LF touches down at phase 0."""
    zero = jnp.zeros_like(gait.pair_lag)
    touch_down = jnp.stack([zero, gait.fore_lag, gait.pair_lag, gait.pair_lag + gait.hind_lag])
    stand = jnp.stack([gait.fore_duty, gait.fore_duty, gait.hind_duty, gait.hind_duty])
    return GaitPattern(gait.cycle_duration, wrap(touch_down), wrap(touch_down + stand))


def duty_factors(pattern: GaitPattern) -> Array:
    """Share of the stride that each leg stands, in (0, 1]."""
    return 1.0 - wrap(pattern.touch_down - pattern.lift_off)


def advance(pattern: GaitPattern, phase: Array, period: Array) -> Array:
    """Cycle phase one control period (s) later."""
    return wrap(phase + period / pattern.stride_duration)


def leg_phases(pattern: GaitPattern, phase: Array) -> LegPhases:
    """Stance and swing of every leg at a cycle phase ()."""
    duty = duty_factors(pattern)
    swing_share = jnp.maximum(1.0 - duty, SHORTEST_SWING)
    since_touch_down = wrap(phase - pattern.touch_down)
    stance = since_touch_down < duty
    return LegPhases(
        stance=stance.astype(duty.dtype),
        stance_phase=jnp.minimum(since_touch_down / duty, 1.0),
        swing_phase=jnp.where(stance, 0.0, jnp.minimum((since_touch_down - duty) / swing_share, 1.0)),
        stance_duration=duty * pattern.stride_duration,
        swing_duration=swing_share * pattern.stride_duration,
    )


def interpolate(start: GaitPattern, end: GaitPattern, fraction: Array) -> GaitPattern:
    """Gait between two gaits: touch-downs go the shorter way round the cycle, duty factors straight."""
    way = wrap(end.touch_down - start.touch_down + 0.5) - 0.5
    touch_down = wrap(start.touch_down + fraction * way)
    duty = duty_factors(start) + fraction * (duty_factors(end) - duty_factors(start))
    stride = start.stride_duration + fraction * (end.stride_duration - start.stride_duration)
    return GaitPattern(stride, touch_down, touch_down + duty)


def standing(pattern: GaitPattern) -> GaitPattern:
    """The pattern with all legs on the ground all the time: where every gait starts from."""
    return pattern._replace(lift_off=pattern.touch_down + 1.0)
