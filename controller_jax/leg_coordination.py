"""Which leg supports and which swings, from the plan and from contact (V.B.1), and the reflexes to surprises.

All as arrays over the legs. Rules (FACTS 3.4): a leg supports if it is planned to stand, touches and does not
slip. A touching leg in swing is late to lift off (early in the swing: it swings on), early to touch down (late
in the swing: it supports at once), or has hit an obstacle (between: it is raised). A leg that should stand but
does not touch, or slips, is lowered along the ground's normal until it finds ground: from where it was, held there
sideways, and at a speed of its own, because a target tied to the present foot follows a falling torso upwards.
"""

from typing import NamedTuple

import jax.numpy as jnp

from controller_jax.gait import LegPhases
from controller_jax.types import Array


class CoordinationParams(NamedTuple):
    """Thresholds and reflexes."""

    late_lift_off: Array  # () swing phase up to which contact means a late lift-off
    early_touch_down: Array  # () swing phase from which contact means an early touch-down
    tolerance: Array  # () phase by which touch-down and lift-off may differ from the plan without an event
    slip_distance: Array  # () m, and
    slip_speed: Array  # () m/s, both exceeded by a foot that slips
    contact_hold: Array  # () s for which a support leg may lose contact and still push
    lowering: Array  # () m by which a foot that seeks the ground starts below where it was, and
    lowering_speed: Array  # () m/s at which it goes on along the ground's normal, whatever the torso does
    raising: Array  # () m above the present foot, and added to the swing, after hitting an obstacle


class LegMemory(NamedTuple):
    """What the coordinator carries from tick to tick."""

    foothold_W: Array  # (4, 3) last point in contact, where the next swing starts, m
    slip_W: Array  # (4, 3) way slipped since the present stance began, m
    touched: Array  # (4,) 1.0 once the foot has touched in this stance
    lift_off_phase: Array  # (4,) swing phase at which the foot really left the ground
    obstacle: Array  # (4,) 1.0 once the foot has hit something in this swing
    air_time: Array  # (4,) s since the last contact
    sought_W: Array  # (4, 3) where a foot without contact goes to find ground, m


class LegEvents(NamedTuple):
    """1.0 where something departs from the plan; every field (4,)."""

    early_touch_down: Array
    late_touch_down: Array
    early_lift_off: Array
    late_lift_off: Array
    slip: Array
    lost_contact: Array
    obstacle: Array


class LegRoles(NamedTuple):
    """What each leg has to do; every field (4,)."""

    support: Array  # 1.0 force-controlled, 0.0 position-controlled
    swing_progress: Array  # 0..1 from the real lift-off to the planned touch-down
    raising: Array  # m above the present foot, 0 to follow the swing
    seek: Array  # 1.0 where the foot goes to the memory's `sought_W`
    clearance: Array  # m on top of the apex of the swing


def standing(soles_W: Array) -> LegMemory:
    """Memory of four legs that stand on soles_W (4, 3)."""
    zero = jnp.zeros(4, soles_W.dtype)
    return LegMemory(soles_W, jnp.zeros_like(soles_W), zero + 1.0, zero, zero, zero, soles_W)


def coordinate(
    params: CoordinationParams,
    memory: LegMemory,
    phases: LegPhases,
    contact: Array,
    soles_W: Array,
    slip_velocity_W: Array,
    normal_W: Array,
    period: Array,
) -> tuple[LegMemory, LegRoles, LegEvents]:
    """One control period (s). contact (4,) 0 or 1; soles_W (4, 3) m; slip_velocity_W (4, 3) of the soles, m/s.

    normal_W: (3,) of the ground, along which a foot seeks contact.
    """

    def flag(x):
        return x.astype(soles_W.dtype)

    stand, touch = phases.stance > 0.0, contact > 0.0
    late_swing = phases.swing_phase > params.early_touch_down
    surprises = _surprises(params, phases, memory.touched > 0.0, stand, touch)
    lands = touch & (stand | surprises.early_touch_down)
    slip_W, slips = _slip(params, memory, stand & touch, lands, slip_velocity_W, period)

    # a foot that bounces keeps pushing: position control would throw it about and be late when it is back
    air_time = jnp.where(touch, 0.0, memory.air_time + period)
    holds = touch | ((memory.touched > 0.0) & (air_time <= params.contact_hold))
    seek = (stand & ~holds & ~surprises.early_lift_off) | slips
    below = memory.sought_W - period * params.lowering_speed * normal_W[None]
    sought_W = jnp.where(seek[:, None], below, soles_W - params.lowering * normal_W[None])
    hit = ~stand & ((memory.obstacle > 0.0) | surprises.obstacle)
    lift_off_phase = jnp.where(surprises.late_lift_off, phases.swing_phase, memory.lift_off_phase)
    lift_off_phase = jnp.where(stand, 0.0, lift_off_phase)

    memory = LegMemory(
        foothold_W=jnp.where((lands | surprises.late_lift_off)[:, None], soles_W, memory.foothold_W),
        slip_W=slip_W,
        touched=flag((stand | late_swing) & ((memory.touched > 0.0) | lands)),
        lift_off_phase=lift_off_phase,
        obstacle=flag(hit),
        air_time=air_time,
        sought_W=sought_W,
    )
    roles = LegRoles(
        support=flag((stand | late_swing) & holds & ~slips),
        swing_progress=(phases.swing_phase - lift_off_phase) / (1.0 - lift_off_phase),
        raising=params.raising * flag(surprises.obstacle),
        seek=flag(seek),
        clearance=params.raising * flag(hit),
    )
    told = surprises.late_lift_off & (phases.swing_phase > params.tolerance)
    events = LegEvents(*(flag(x) for x in surprises._replace(slip=slips, late_lift_off=told)))
    return memory, roles, events


def _surprises(params: CoordinationParams, phases: LegPhases, touched: Array, stand: Array, touch: Array) -> LegEvents:
    """Where contact departs from the plan, as truth values; without the slip, which contact alone does not tell."""
    swing, air = ~stand, ~touch
    early_touch_down = swing & touch & (phases.swing_phase > params.early_touch_down)
    late_lift_off = swing & touch & (phases.swing_phase <= params.late_lift_off)
    ending = phases.stance_phase > 1.0 - params.tolerance
    return LegEvents(
        early_touch_down=early_touch_down,
        late_touch_down=stand & air & ~touched & (phases.stance_phase > params.tolerance),
        early_lift_off=stand & air & touched & ending,
        late_lift_off=late_lift_off,
        slip=jnp.zeros_like(stand),
        lost_contact=stand & air & touched & ~ending,
        obstacle=swing & touch & ~early_touch_down & ~late_lift_off,
    )


def _slip(
    params: CoordinationParams, memory: LegMemory, stands: Array, lands: Array, velocity_W: Array, period: Array
) -> tuple[Array, Array]:
    """Way slipped since touch-down, m (4, 3), and which standing feet slip: far and fast."""
    slip_W = jnp.where((lands & (memory.touched > 0.0))[:, None], memory.slip_W + period * velocity_W, 0.0)
    far = (slip_W * slip_W).sum(-1) > params.slip_distance**2
    fast = (velocity_W * velocity_W).sum(-1) > params.slip_speed**2
    return slip_W, stands & far & fast
