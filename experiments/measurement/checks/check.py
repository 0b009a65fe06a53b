"""Whether a log may be believed: data faults, named for what they are before anybody takes them for physics."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from experiments.measurement.checks.fault_search import FaultSearch, Finding
from experiments.measurement.checks.faults import Fault, listed
from experiments.measurement.checks.noise_claims import noise_claims
from experiments.measurement.checks.time_faults import time_faults
from experiments.measurement.checks.value_faults import value_faults
from experiments.measurement.logs.log import Log, si_unit, signal_names
from experiments.measurement.logs.resample import resample
from experiments.measurement.logs.units import CONVERSIONS


def check(log: Log, numbers: Mapping[str, Any]) -> list[Fault]:
    """The data faults of a log, none if it may be believed; `numbers` are the robot's (unused on a bench).

    Rows and single columns are looked at first; only where they are sound, what columns owe one another; then what
    the JSON says of their noise, which a wrong unit would make wrong too.
    """
    faults = list(time_faults(log)) or list(value_faults(log, numbers))
    faults = faults or in_words(FaultSearch(resample(log), numbers).run(), log)
    return faults or list(noise_claims(log))


def in_words(findings: Iterable[Finding], log: Log) -> list[Fault]:
    """One fault for all findings of a kind in the same signals, the most convincing first."""
    groups: dict[tuple[Any, ...], Finding] = {}
    for found in findings:
        repair = found.repair
        key = (repair.kind, repair.signals, repair.value)
        if key in groups:
            names = tuple(dict.fromkeys((*groups[key].repair.names, *repair.names)))
            found = replace(groups[key], repair=replace(groups[key].repair, names=names))
        groups[key] = found
    return [_fault(found, log) for found in groups.values()]


def _fault(found: Finding, log: Log) -> Fault:
    repair = found.repair
    everything = signal_names(repair.signals[0], log.joint)
    where = listed(repair.names, everything)
    signals = listed(repair.signals) if len(repair.signals) < 4 else "the columns"
    what = f"{signals} of {where}"
    many = len(repair.names) * len(repair.signals) > 1
    match repair.kind:
        case "sign":
            message = f"{what} {'have' if many else 'has'} the wrong sign; turn it with 'scale = -1' in a column map."
        case "unit":
            message = f"{what} {'are' if many else 'is'} {_unit(found, log)}"
        case "time_shift":
            late = "late" if repair.value > 0 else "early"
            samples = abs(repair.value)
            by = f"{samples:g} samples ({1e3 * samples * log.sample_period:.4g} ms) {late}"
            message = f"{what} {'are' if many else 'is'} {by} against the other signals; shift it back in time."
        case "swapped_joints" | "swapped_axes":
            order = "are swapped" if len(repair.names) == 2 else "stand in the wrong order"
            message = f"{what} {order}; put each column under its own name with a column map."
        case "unrelated":
            agree = "agree" if many else "agrees"
            message = (
                f"{what} {agree} with no other signal at any gain or delay; it is another quantity under this name, or "
                "the sensor is broken."
            )
        case _:
            form = "turns from world to torso" if "inverse" in repair.names else "has its scalar part last"
            message = f"base_orientation {form}; the columns are w x y z, torso to world."
    return Fault(repair.kind, where, message)


def _unit(found: Finding, log: Log) -> str:
    """What a column is wrong by: a known unit, the gear, or just a number."""
    repair = found.repair
    si = si_unit(repair.signals[0], log.joint)
    for unit, factor in CONVERSIONS[si].items():
        if factor != 1.0 and abs(factor * repair.value - 1.0) < 1e-6:
            return f"in {unit}, not in {si}; say so under 'units' in the log's JSON or in a column map."
    return f"{repair.value:.4g} times what the other signals say; correct it with 'scale' in a column map."
