"""Recordings as logs: a gzipped CSV and a small JSON, one row per sample, columns `signal/name`."""

import gzip
import io
import math
from pathlib import Path

import numpy as np

from experiments.files import write_bytes, write_json
from experiments.independent_plant.bench_bodies import Load
from experiments.independent_plant.numbers import JOINT_NAMES, LEGS, Array
from experiments.independent_plant.plant import PERIOD, Recording
from experiments.independent_plant.sensors import NOISE_STD, QUANTUM, SensorSettings

DIGITS = "%.7g"
XYZ = ("x", "y", "z")
NAMES = {
    "base_position": XYZ,
    "base_orientation": ("w", *XYZ),
    "base_linear_velocity": XYZ,
    "base_angular_velocity": XYZ,
    "base_acceleration": XYZ,
    "foot_contact": LEGS,
}


def columns(recording: Recording, log: int, joint: int | None = None) -> dict[str, Array]:
    """The log's columns in order, each (T,); on a bench (`joint` given) the one joint is called `axis`."""
    signals = {
        "command_torque": recording.command.torque,
        "command_position": recording.command.position,
        **recording.signals,
    }
    table = {}
    for signal, values in signals.items():
        names = NAMES.get(signal, JOINT_NAMES)
        if joint is not None:
            if not np.isnan(values[log, :, joint]).all():
                table[f"{signal}/axis"] = values[log, :, joint]
            continue
        table |= {f"{signal}/{name}": values[log, :, i] for i, name in enumerate(names)}
    return table


def noise_std(settings: SensorSettings, signals: list[str]) -> dict[str, float]:
    """What the JSON says of the noise: sensor noise and quantisation together."""
    known = {}
    for signal in signals:
        if signal in NOISE_STD:
            rounding = QUANTUM[signal] / math.sqrt(12.0) if settings.quantised else 0.0
            known[signal] = float(f"{math.hypot(settings.noise * NOISE_STD[signal], rounding):.4g}")
    return {signal: std for signal, std in known.items() if std > 0.0}


def write_log(path: Path, table: dict[str, Array], info: dict, period: float = PERIOD) -> None:
    """`<path>.csv.gz` and `<path>.json`; empty cells for NaN. The same content gives the same bytes.

    The table comes last, so that where there is one the log is whole, at whatever moment a job is killed.
    """
    rows = np.column_stack([np.arange(len(next(iter(table.values())))) * period, *table.values()])
    line = ",".join([DIGITS] * rows.shape[1]) + "\n"
    text = ",".join(["time", *table]) + "\n" + "".join(line % tuple(row) for row in rows.tolist())
    path.parent.mkdir(parents=True, exist_ok=True)
    table_file = io.BytesIO()
    with gzip.GzipFile("", "wb", 6, table_file, mtime=0) as packed:
        packed.write(text.replace("nan", "").replace("-0,", "0,").encode())
    write_json(f"{path}.json", info)
    write_bytes(f"{path}.csv.gz", table_file.getvalue())


def robot_info(experiment: str, settings: SensorSettings, signals: list[str]) -> dict:
    """The JSON beside a log of the whole robot; `experiment` is `fixed_base` or `ground`."""
    return {
        "robot": "starleth",
        "experiment": experiment,
        "sample_period": PERIOD,
        "noise_std": noise_std(settings, signals),
    }


def bench_info(load: Load, drive: str, settings: SensorSettings, signals: list[str], period: float) -> dict:
    """The JSON beside a bench log; `drive` is `rigid` or the joint kind whose series-elastic drive it is."""
    return {
        "robot": "joint",
        "experiment": "bench",
        "sample_period": period,
        "noise_std": noise_std(settings, signals),
        "joint": {
            "name": "axis",
            "kind": "revolute",
            "inertia": load.inertia,
            "viscous_friction": load.viscous_friction,
            "gravity_load": load.gravity_load,
        },
        "drive": drive,
    }
