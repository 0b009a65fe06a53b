"""Faults of single columns: no values, a joint that never moves, a sensor that is dead, held, cut off or copied."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np

from experiments.measurement.checks.copied_columns import copied_columns
from experiments.measurement.checks.faults import Fault, listed
from experiments.measurement.checks.matching import Array
from experiments.measurement.checks.runs import Runs, is_clipped, is_stuck
from experiments.measurement.checks.spikes import spikes
from experiments.measurement.checks.time_faults import is_measured
from experiments.measurement.checks.torso_faults import torso_faults
from experiments.measurement.logs.log import SIGNALS, Log, SignalTable, signal_names
from experiments.measurement.logs.noise_floor import estimated

# A few lost values are bridged; a block is a transient that nobody saw
_BLOCK: Final = 4  # rows
_MISSING_SHARE: Final = 0.01
_STILL: Final = 5e-3  # rad (or m): a joint that stays within tells nothing, whatever its sensor's noise
_HARDLY: Final = 4.0 * _STILL  # what the others of a kind that is held move by, at most
_COMMANDED: Final = 0.05  # rad: a command that goes further than this should have moved the joint
_WINDS_UP: Final = 0.9  # correlation of motor position and spring torque
_SAME_MOTION: Final = 0.99  # correlation of an encoder in a wrong unit with the motor
_ALOOF: Final = 10.0  # times as far has a joint to go where another signal is to show it


def value_faults(log: Log, numbers: Mapping[str, Any]) -> Iterator[Fault]:
    """What single columns and vectors show by themselves, one fault for all columns of a signal that share it."""
    missing = [fault for signal in log.signals for fault in _no_value(log, signal)]
    yield from missing or _no_command(log)
    if missing:
        return
    still = _joints_within(log, _STILL)
    yield from _never_moves(log, still)
    for signal, table in log.signals.items():
        if is_measured(signal) and not (log.experiment == "fixed_base" and signal.startswith("base_")):
            yield from _broken_sensor(log, signal, table, still, numbers)
    yield from spikes(log)
    yield from copied_columns(log)
    yield from torso_faults(log, numbers)


def _no_value(log: Log, signal: str) -> Iterator[Fault]:
    table = log.signals[signal]
    infinite = np.isinf(table.values)
    if infinite.any():
        row, place = (int(i[0]) for i in np.nonzero(infinite))
        what = f"{signal} of {table.names[place]} is infinite at {log.time[row]:.6g} s"
        yield Fault("no_value", table.names[place], f"{what}; leave the cell empty instead.")
    if SIGNALS[signal].commanded:
        return  # empty in the other mode
    missing = np.isnan(table.values)
    holes = np.array([_has_hole(column) for column in missing.T])
    if holes.any():
        names = _chosen(table, holes)
        rows = missing[:, holes].any(1)
        where = listed(names, signal_names(signal, log.joint))
        yield Fault(
            "no_value",
            where,
            f"{signal} of {where} has no value in {int(rows.sum())} of {log.rows} rows, first at "
            f"{log.time[np.argmax(rows)]:.6g} s; leave such columns out, cut the rows off or record the log again.",
        )


def _has_hole(missing: Array) -> bool:
    """Whether values lack in a block or often, other than by the even rhythm of a slower sensor."""
    if not missing.any():
        return False
    there = np.flatnonzero(~missing)
    if there.size < 2:
        return True
    distance = np.diff(there)
    rhythm = int(np.median(distance))
    edges = max(there[0], len(missing) - 1 - there[-1])
    if rhythm > 1:
        return bool(max(distance.max(), edges + 1) > 3 * rhythm)
    return bool(max(distance.max() - 1, edges) >= _BLOCK or missing.mean() > _MISSING_SHARE)


def _no_command(log: Log) -> Iterator[Fault]:
    """Rows in which a joint that is commanded elsewhere has neither a torque nor a position to follow."""
    commands = [c for c in (log.joints("command_torque"), log.joints("command_position")) if c is not None]
    if not commands:
        return
    nothing = np.all([np.isnan(c) for c in commands], axis=0)
    lacking = (nothing.sum(0) >= _BLOCK) & ~nothing.all(0)
    if lacking.any():
        where = listed(tuple(np.array(log.joint_names)[lacking]), log.joint_names)
        rows = nothing[:, lacking].any(1)
        yield Fault(
            "no_value",
            where,
            f"{where} has neither command_torque nor command_position in {int(rows.sum())} rows, first at "
            f"{log.time[np.argmax(rows)]:.6g} s; log the command of every tick.",
        )


def _joints_within(log: Log, least: float) -> tuple[str, ...]:
    """Joints that move by less than this [rad or m]."""
    q = log.joints("joint_position")
    if q is None:
        return ()
    logged = np.isfinite(q).any(0)
    return tuple(np.array(log.joint_names)[logged & (_spread(q) < least)])


def _never_moves(log: Log, still: tuple[str, ...]) -> Iterator[Fault]:
    moved = np.zeros(len(log.joint_names))
    for signal in ("command_position", "motor_position"):
        if (values := log.joints(signal)) is not None:
            moved = np.fmax(moved, _spread(values))
    asked = tuple(name for name, by in zip(log.joint_names, moved, strict=True) if name in still and by > _COMMANDED)
    driven = tuple(name for name in asked if not _stalls(log, name) and not _follows(log, name))
    idle = tuple(name for name in still if name not in asked)
    if driven:
        where = listed(driven, log.joint_names)
        what = f"{where} never moved by its encoder though it was driven"
        yield Fault("joint_never_moves", where, f"{what}; free the joint or repair the encoder.")
    elif idle and not all(_held_on_purpose(name, log) for name in idle):
        where = listed(idle, log.joint_names)
        what = f"{where} never moved, so the log says nothing of friction, inertia or backlash there"
        yield Fault("joint_never_moves", where, f"{what}; move every joint that is to be judged.")


def _stalls(log: Log, name: str) -> bool:
    """Whether the motor winds the spring up: the joint really stands, by friction perhaps, and the encoder is right."""
    return _correlation(log.column("motor_position", name), log.column("joint_torque", name)) > _WINDS_UP


def _follows(log: Log, name: str) -> bool:
    """Whether the encoder shows every motion of the motor, only too small: its unit is wrong."""
    return abs(_correlation(log.column("motor_position", name), log.column("joint_position", name))) > _SAME_MOTION


def _correlation(one: Array | None, other: Array | None) -> float:
    """0 where a column lacks or never changes."""
    if one is None or other is None:
        return 0.0
    there = np.isfinite(one) & np.isfinite(other)
    if not there.any() or np.ptp(one[there]) == 0 or np.ptp(other[there]) == 0:
        return 0.0
    return float(np.corrcoef(one[there], other[there])[0, 1])


def _held_on_purpose(name: str, log: Log) -> bool:
    """Whether its whole leg, or all joints of its kind, are held: done on purpose, unlike a joint here and there."""
    hardly = _joints_within(log, _HARDLY)
    return any(
        {other for other in log.joint_names if part in other.split("_")} <= set(hardly)
        for part in name.split("_")
        if len(hardly) < len(log.joint_names)
    )


def _broken_sensor(
    log: Log, signal: str, table: SignalTable, still: tuple[str, ...], numbers: Mapping[str, Any]
) -> Iterator[Fault]:
    """A sensor with noise never reads the same throughout, hangs, or lies flat at its extreme."""
    dead, stuck, clipped = (np.zeros(len(table.names), dtype=bool) for _ in range(3))
    limit = numbers["drive"]["current_limit"] if signal == "motor_current" and log.joint is None else None
    for place, (name, column) in enumerate(zip(table.names, table.values.T, strict=True)):
        values = column[np.isfinite(column)]
        if name in still or not values.size:
            continue
        runs = Runs.of(values)
        dead[place] = len(runs.lengths) == 1
        if dead[place]:
            continue
        clipped[place] = is_clipped(runs, values, limit)
        moves = _motion(log, signal, name, np.isfinite(column))
        dithers = signal.startswith("base_") and _dithers(values, runs)
        stuck[place] = not clipped[place] and is_stuck(runs, values, moves, dithers)
    kinds = (
        ("dead_sensor", dead, "reads the same value throughout; repair the sensor or leave the column out."),
        ("stuck_sensor", stuck, "hangs at one value for many rows; cut these rows off or record the log again."),
        ("clipped_sensor", clipped, "is cut off at the end of the sensor's range; repeat with less or a wider range."),
    )
    for fault, flags, message in kinds:
        if flags.any():
            where = listed(_chosen(table, flags), signal_names(signal, log.joint))
            yield Fault(fault, where, f"{signal} of {where} {message}")


def _dithers(values: Array, runs: Runs) -> bool:
    """Whether noise exceeds the resolution: then a sensor never rests, whatever it measures."""
    return estimated(values[:, None]) > float(np.abs(np.diff(values[runs.starts])).min())


def _motion(log: Log, signal: str, name: str, rows: Array) -> Array:
    """How far the joint has come on these rows in units of a travel that this signal must show; empty if unknown.

    A velocity is judged by the position of its side. Others by more motion: a held joint with a coarse encoder and a
    velocity that is a little off does not move, and a torque may rest at zero within a gear's play.
    """
    if signal in ("joint_position", "motor_position"):
        velocity = log.column(signal.replace("position", "velocity"), name)
        travel = None if velocity is None else np.cumsum(np.nan_to_num(velocity)) * log.sample_period / _ALOOF
    elif signal in ("joint_velocity", "motor_velocity"):
        travel = log.column(signal.replace("velocity", "position"), name)
    else:
        position = log.column("joint_position", name)
        travel = None if position is None else position / _ALOOF
    return np.zeros(0) if travel is None or np.isnan(travel[rows]).any() else travel[rows]


def _chosen(table: SignalTable, flags: Array) -> tuple[str, ...]:
    return tuple(name for name, flag in zip(table.names, flags, strict=True) if flag)


def _spread(values: Array) -> Array:
    """Range of each column without its few wildest samples; 0 where there are no values."""
    spread = np.zeros(values.shape[1])
    for place, column in enumerate(values.T):
        finite = column[np.isfinite(column)]
        if finite.size:
            low, high = np.percentile(finite, [0.5, 99.5])
            spread[place] = high - low
    return spread
