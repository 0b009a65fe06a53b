"""Replays a measurement through a drive: the logged commands, acting on the links' measured motion.

What comes out is what the drive's own sensors should have read. The misfit belongs to the drive alone, because the
bodies never enter: both sides of the spring are measured. A pure scan over rows: differentiable with respect to
params and start, vmappable over hypotheses.

Learnt on the reference logs, where the replay leaves nothing but the sensors' noise:
- A row's command acts from its time to the next row's; joint torque, motor position and current of a row are the
  state at its time.
- The joint controllers act on the noisy position, velocity and torque of the same row, but on the drive's own
  motor angle and not on its logged reading. With the logged one, position mode integrates the reading's noise.
- In torque mode nothing holds the motor angle but the velocity loop: the noise of the first row's angle stays for
  the whole replay: whoever compares has to take it out.
- Logs begin at rest with current and integrators at zero, even where the springs are loaded.
- No friction by radial load is in these logs: a load of 200 N would show as 0.7 standard deviations of current.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from sea_jax.control_period import signals_at
from sea_jax.delay_line import LONGEST, delayed, earlier, motion_later
from sea_jax.electronics import back_emf
from sea_jax.full_drive import watched_drive
from sea_jax.motor import spring_on_link
from sea_jax.parameters import DriveParams, LoopPeriods
from sea_jax.types import Array, DriveHooks, DriveState, JointCommand, JointMeasurement, JointMotion


class ReplayRows(NamedTuple):
    """A log at the control rate; every array is (T, J)."""

    command: JointCommand  # held from a row to the next
    measurement: JointMeasurement  # what the joint controllers saw
    motion: JointMotion  # of the links from a row to the next


class Timing(NamedTuple):
    """What no log tells of when things happen within a row, (J,)."""

    loop_phase: Array  # s after the row's time at which its velocity loops run, 0 up to a period of theirs
    angle_lead: Array  # s by which the semi-implicit step's angle runs ahead; half a step against an exact plant
    link_age: Array  # s by which the joint encoders' rows are late, up to LONGEST periods
    drive_age: Array  # s by which the drive's own sensors are late, for the log and for the joint controllers


class Trajectory(NamedTuple):
    """The drive at each row's time, (T, J)."""

    motor_position: Array  # gear output side, rad
    motor_velocity: Array  # rad/s
    motor_current: Array  # A
    joint_torque: Array  # spring torque on the link, N m


def measured_start(
    params: DriveParams,
    motor_position: Array,
    motor_velocity: Array,
    motor_current: Array,
    memory: dict[str, tuple] | None = None,
) -> DriveState:
    """State at the first row from its sensors, (J,), with the integrators that would keep the current."""
    held = params.resistance * motor_current + back_emf(params, motor_velocity)
    return DriveState(
        motor_position,
        motor_velocity,
        motor_current,
        velocity_integral=motor_current,
        current_integral=held,
        voltage=held,
        memory={} if memory is None else dict(memory),
    )


def replay(
    params: DriveParams,
    hooks: DriveHooks,
    rows: ReplayRows,
    start: DriveState,
    periods: LoopPeriods = LoopPeriods(),  # noqa: B008
    own_motor_angle: bool = True,
    timing: Timing | None = None,
) -> Trajectory:
    """What the drive's sensors read at each row, without noise; row 0 is `start`.

    own_motor_angle: the joint controllers get the replayed motor angle, not rows.measurement.motor_position.
    timing: without one, the loops run at the rows' times and the angle is that of the semi-implicit step.
    """
    still = jnp.zeros_like(start.motor_position)
    timing = Timing(*(still,) * 4) if timing is None else timing
    # The drive's clock starts with its velocity loop: links are seen later than the row, sensors read before it.
    lead = timing.loop_phase + timing.angle_lead
    before = timing.loop_phase + timing.drive_age
    whole = jnp.floor(before / periods.control)
    read = before - whole * periods.control  # s before a row's end in the drive's clock at which its sensors are read
    row_ends = periods.velocity_steps * periods.current_steps - read / periods.current
    rows = rows._replace(motion=motion_later(rows.motion, timing.link_age, periods.control))

    def add_if_at_row(sensed, state, time):
        # between steps along straight lines; whole numbers, so that a step at the row is taken as it is
        away = jnp.abs(row_ends - jnp.round(time / periods.current))
        return tuple(x + jnp.maximum(1.0 - away, 0.0) * now for x, now in zip(sensed, _sensed(state), strict=True))

    def row(carry, inputs):
        state, seen, past = carry
        command, measurement, motion = inputs
        history = jnp.concatenate([seen.motor_position[:, None], past], 1)
        if own_motor_angle:
            measurement = measurement._replace(motor_position=delayed(history, whole))
        moved = (command, measurement, _later(motion, lead))
        begun = add_if_at_row((still, still, still), state, 0.0)
        state, _, (angle, velocity, current) = watched_drive(params, state, moved, hooks, periods, begun, add_if_at_row)
        angle = angle - timing.angle_lead * velocity
        time = periods.control + timing.loop_phase - read
        end = signals_at(params, state, motion, time, periods.current)
        end = end._replace(motor_position=angle, motor_velocity=velocity, current=current)
        torque, _, _ = spring_on_link(params, hooks, end, state.memory)
        return (state, Trajectory(angle, velocity, current, torque), history[:, :LONGEST]), seen

    first = jax.tree.map(lambda x: x[0], rows.motion)
    torque, _, _ = spring_on_link(params, hooks, signals_at(params, start, first, 0.0, periods.current), start.memory)
    seen = Trajectory(*_sensed(start), torque)
    past = jnp.repeat(seen.motor_position[:, None], LONGEST, 1)
    _, trajectory = jax.lax.scan(row, (start, seen, past), tuple(rows))
    return Trajectory(*(earlier(channel, whole) for channel in trajectory))


def _sensed(state: DriveState) -> tuple[Array, Array, Array]:
    return state.motor_position, state.motor_velocity, state.current


def _later(motion: JointMotion, time: Array) -> JointMotion:
    """The links' motion from `time` (J,) s after each row on."""
    turned = motion.acceleration * time
    position = motion.position + time * (motion.velocity + 0.5 * turned)
    return motion._replace(position=position, velocity=motion.velocity + turned)
