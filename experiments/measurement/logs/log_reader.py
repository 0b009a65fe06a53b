"""From files to a `Log`: the table by its ending, the JSON beside it, units and names by a column map."""

from collections.abc import Iterable
from pathlib import Path
from typing import Final

import numpy as np

from experiments.errors import UserError
from experiments.files import read_bytes, shown
from experiments.measurement.logs.binary_tables import read_npz, read_parquet
from experiments.measurement.logs.column_map import ColumnMap, conversions, read_column_map
from experiments.measurement.logs.csv_table import read_csv
from experiments.measurement.logs.log import SIGNALS, BenchJoint, Log, SignalTable, signal_names
from experiments.measurement.logs.log_info import LogInfo, read_info
from experiments.measurement.logs.table_limits import LIMITS, Columns, Limits

ENDINGS: Final = (".csv", ".csv.gz", ".parquet", ".npz")


def read_log(
    path: Path | str,
    info: Path | str | LogInfo | None = None,
    column_map: Path | str | ColumnMap | None = None,
    limits: Limits = LIMITS,
) -> Log:
    """Read one experiment.

    `info` is the JSON that describes it, by default the file of the same name that ends in `.json`;
    `column_map` says what is what where the log names things otherwise. Raises UserError in one sentence.
    """
    path = Path(path)
    ending = log_ending(path)
    if not isinstance(info, LogInfo):
        info = read_info(Path(info) if info is not None else info_path(path))
    if not isinstance(column_map, ColumnMap):
        column_map = ColumnMap() if column_map is None else read_column_map(Path(column_map))
    data = read_bytes(path, limits.file_bytes)
    name = shown(path)
    if ending in (".csv", ".csv.gz"):
        columns = read_csv(data, name, ending == ".csv.gz", column_map.delimiter, limits)
    else:
        columns = (read_parquet if ending == ".parquet" else read_npz)(data, name, limits)
    return make_log(columns, info, column_map, name=path.name.removesuffix(ending))


def log_ending(path: Path) -> str:
    """Which of ENDINGS the file has. Raises UserError for any other."""
    ending = next((ending for ending in ENDINGS if path.name.endswith(ending)), None)
    if ending is None:
        raise UserError(f"{shown(path)} is no log by its name; a log ends in {', '.join(ENDINGS)}.")
    return ending


def info_path(path: Path) -> Path:
    """The JSON beside a log: run.json for run.csv.gz. Raises UserError if it is not there."""
    beside = path.with_name(path.name.removesuffix(log_ending(path)) + ".json")
    if not path.exists():
        raise UserError(f"cannot read {shown(path)}: no such file.")
    if not beside.exists():
        raise UserError(f"{shown(path)} has no {shown(beside.name)} beside it; write one or name the log's JSON.")
    return beside


def make_log(columns: Columns, info: LogInfo, column_map: ColumnMap | None = None, name: str = "log") -> Log:
    """A log from columns in memory, with the names of the format or of the column map. Raises UserError."""
    wanted = conversions(list(columns), column_map or ColumnMap(), info)
    if "time" not in wanted:
        raise UserError(f"{name} has no column 'time'; name the column that holds it in a column map.")
    lengths = {columns[conversion.source].size for conversion in wanted.values()}
    if len(lengths) > 1:
        raise UserError(f"{name}: the columns have different lengths, from {min(lengths)} to {max(lengths)} rows.")
    names, unread = _names_by_signal(wanted, info, name)

    def values(column: str) -> np.ndarray:
        conversion = wanted[column]
        with np.errstate(over="ignore", invalid="ignore"):
            return columns[conversion.source] * conversion.factor + conversion.offset

    tables = {
        signal: SignalTable(its, np.stack([values(f"{signal}/{of}") for of in its], axis=1))
        for signal, its in names.items()
    }
    return Log(
        robot=info.robot,
        experiment=info.experiment,
        sample_period=info.sample_period,
        noise_std={signal: std for signal, std in info.noise_std.items() if std > 0},  # 0: not known
        joint=_with_drive(info),
        time=values("time"),
        signals=tables,
        name=name,
        source=info.source,
        unread=unread,
    )


def _names_by_signal(
    columns: Iterable[str], info: LogInfo, log: str
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Of each signal, what its columns are of, in the format's order; and what no one reads. Raises UserError."""
    found: dict[str, list[str]] = {}
    unread = [f"key {key}" for key in info.unknown_keys]
    for column in columns:
        signal, _, of = column.partition("/")
        if signal not in SIGNALS:
            unread += [] if column == "time" else [column]
        elif of not in signal_names(signal, info.joint):
            known = ", ".join(signal_names(signal, info.joint))
            raise UserError(
                f"{log}: column {shown(column)} names something that robot '{info.robot}' does not have "
                f"({signal}: {known}); say what it is in a column map, or correct 'robot' in the JSON."
            )
        else:
            found.setdefault(signal, []).append(of)
    names = {s: tuple(of for of in signal_names(s, info.joint) if of in found[s]) for s in SIGNALS if s in found}
    return names, tuple(unread)


def _with_drive(info: LogInfo) -> BenchJoint | None:
    if info.joint is None or info.drive is None or info.joint.drive is not None:
        return info.joint
    return info.joint.model_copy(update={"drive": info.drive})
