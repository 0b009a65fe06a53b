"""Desired motion of the torso (V.A.3): balance over the feet, height and pitch by periodic splines, slope.

Height is planned at the fore and at the hind hips; their mean is the torso's height, their difference its pitch.
Each is an offset, a polyharmonic spline through four knots a quarter of a cycle apart, and the hop that the
contact schedule asks of physics: with nothing on the ground a girdle can only fall, so its height must be a
parabola while its legs swing, and a quintic that joins the parabolas while they stand.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.gait import SHORTEST_SWING, GaitPattern, LegPhases, duty_factors, wrap
from controller_jax.periodic_splines import Curve, polyharmonic, quintic
from controller_jax.rotations import mm, mv, rotation_axis
from controller_jax.terrain_estimator import Plane, height_at
from controller_jax.types import Array
from controller_jax.velocity_command import VelocityCommand


class TorsoParams(NamedTuple):
    """Feed-forward motion of the torso and the weights of the feet."""

    height: Array  # () mean height of the torso origin above the ground, along gravity, m
    once_per_cycle: Array  # (2,) fore, hind: amplitude of the spline's part with the stride's period, m
    twice_per_cycle: Array  # (2,) fore, hind: amplitude of the part with half the stride's period, m
    phase_shift: Array  # () by which height and pitch run ahead of the contact schedule, share of the stride
    hop: Array  # () share of the ballistic hop in the height, 0..1
    hop_pitch: Array  # () share of the ballistic hop in the pitch, 0..1
    speed_lead: Array  # (2,) heading, lateral: share by which the desired velocity exceeds the command
    lowest_weight: Array  # () of a swing leg in the mean of the feet
    stance_fade: Array  # () stance phase from which a leg's weight falls
    swing_rise: Array  # () swing phase from which it rises again
    girdle_distance: Array  # () between fore and hind hips, m
    slope_share: Array  # (2,) roll, pitch: share of the slope that the torso turns with, 1 aligned, 0 level


class TorsoTarget(NamedTuple):
    """Desired motion of the torso, in the world frame."""

    r_WB: Array  # (3,) m
    v_WB: Array  # (3,) m/s
    a_WB: Array  # (3,) m/s^2
    R_WB: Array  # (3, 3)
    omega_W: Array  # (3,) rad/s
    alpha_W: Array  # (3,) rad/s^2


def foot_weights(params: TorsoParams, phases: LegPhases) -> Array:
    """Share (4,) of each foot in the point to balance over; they sum to one."""
    falling = (phases.stance_phase - params.stance_fade) / (1.0 - params.stance_fade)
    rising = (phases.swing_phase - params.swing_rise) / (1.0 - params.swing_rise)
    role = jnp.where(phases.stance > 0.0, 1.0 - jnp.maximum(falling, 0.0), jnp.maximum(rising, 0.0))
    weights = params.lowest_weight + (1.0 - params.lowest_weight) * role
    return weights / weights.sum()


def hop(duty: Array, since_touch_down: Array) -> Curve:
    """Periodic height over the phase since touch-down, in units of g T^2, of a body on one leg; any one shape.

    Curvature -1 in swing (free fall); zero mean. The stance carries what the swing falls. Zero for a leg that never
    swings.
    """
    swing = jnp.maximum(1.0 - duty, SHORTEST_SWING)
    duty = 1.0 - swing
    zero, fall = jnp.zeros_like(duty), jnp.full_like(duty, -1.0)
    landing, leaving = Curve(zero, -0.5 * swing, fall), Curve(zero, 0.5 * swing, fall)
    stance = quintic(landing, leaving, duty, jnp.clip(since_touch_down, zero, duty))
    x = jnp.maximum(since_touch_down - duty, 0.0)
    flight = Curve(0.5 * x * (swing - x), 0.5 * swing - x, fall)
    curve = Curve(*(jnp.where(since_touch_down < duty, s, f) for s, f in zip(stance, flight, strict=True)))
    # mean of the parabola over the swing, and of the quintic, which its end states give, over the stance
    mean = swing**3 / 12.0 - duty**2 * swing / 10.0 - duty**3 / 60.0
    curve = curve._replace(value=curve.value - mean)
    return Curve(*(jnp.where(swing > SHORTEST_SWING, x, 0.0) for x in curve))


def girdle_heights(params: TorsoParams, pattern: GaitPattern, phase: Array, gravity: Array) -> Curve:
    """Fore and hind hip height about the mean height; m, m/s and m/s^2, every field (2,)."""
    T = pattern.stride_duration
    ahead = wrap(phase + params.phase_shift)
    once, twice = params.once_per_cycle, params.twice_per_cycle
    spline = polyharmonic(jnp.stack([once + twice, -twice, twice - once, -twice], -1), ahead)
    legs = hop(duty_factors(pattern), wrap(ahead - pattern.touch_down))

    def compose(spline_part, hop_part, unit):
        girdles = hop_part.reshape(2, 2).mean(1)
        heave = girdles.mean(keepdims=True)
        hops = params.hop * heave + params.hop_pitch * (girdles - heave)
        return spline_part / unit + gravity * T**2 / unit * hops

    return Curve(*(compose(s, h, T**k) for k, (s, h) in enumerate(zip(spline, legs, strict=True))))


def torso_target(
    params: TorsoParams,
    pattern: GaitPattern,
    phases: LegPhases,
    phase: Array,
    feet_W: Array,
    plane: Plane,
    R_WC: Array,
    command: VelocityCommand,
    gravity: Array,
) -> TorsoTarget:
    """Where the torso should be now, given the soles of the feet (4, 3), the ground and the command."""
    heights = girdle_heights(params, pattern, phase, gravity)
    up = jnp.array([0.0, 0.0, 1.0], jnp.float32)
    support = (foot_weights(params, phases)[:, None] * feet_W).sum(0)
    # height counts from the ground under the target, so that the gains along the slope see no height in a lag
    height = height_at(plane, support) + params.height + heights.value.mean()
    rise = (heights.value[1] - heights.value[0]) / params.girdle_distance
    rise_rate = (heights.slope[1] - heights.slope[0]) / params.girdle_distance
    rise_acceleration = (heights.curvature[1] - heights.curvature[0]) / params.girdle_distance
    square = 1.0 + rise * rise
    pitch, pitch_rate = jnp.arctan(rise), rise_rate / square
    pitch_acceleration = rise_acceleration / square - 2.0 * rise * pitch_rate**2
    zero = jnp.zeros_like(pitch)
    lead = 1.0 + params.speed_lead
    v_C = jnp.stack([lead[0] * command.heading, lead[1] * command.lateral, zero])
    omega_C = jnp.stack([zero, pitch_rate, command.turning])
    alpha_C = jnp.stack([zero, pitch_acceleration, zero])
    return TorsoTarget(
        r_WB=jnp.stack([support[0], support[1], height]),
        v_WB=mv(R_WC, v_C) + heights.slope.mean() * up,
        a_WB=heights.curvature.mean() * up,
        R_WB=mm(along_slope(params.slope_share, R_WC), rotation_axis(pitch, 1)),
        omega_W=mv(R_WC, omega_C),
        alpha_W=mv(R_WC, alpha_C),
    )


def along_slope(share: Array, R_WC: Array) -> Array:
    """Orientation (3, 3) of a torso that turns with a share (2,) of the slope in roll and in pitch.

    Legs hang down from the hips: what the torso turns with a slope, HAA and HFE must take back within their stops.
    """
    ahead, left = jnp.arcsin(jnp.clip(R_WC[2, 0], -1.0, 1.0)), jnp.arcsin(jnp.clip(R_WC[2, 1], -1.0, 1.0))
    level = 1.0 - share
    return mm(R_WC, mm(rotation_axis(-level[0] * left, 0), rotation_axis(level[1] * ahead, 1)))
