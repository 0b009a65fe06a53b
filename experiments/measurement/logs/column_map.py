"""Reading a log that names things otherwise: a small TOML or JSON file that says what is what.

    delimiter = ";"                                # CSV only; a comma if absent
    [columns]
    time = { from = "t", unit = "ms" }
    "joint_position/*" = { from = "q_*", unit = "deg" }
    "joint_torque/LF_KFE" = { from = "tau3", unit = "N mm", scale = -1, offset = 0.2 }
    [names]                                        # what stands for '*' where the joint is called otherwise
    LF_HAA = "fl_abad"

A value becomes `value * unit * scale + offset`, the offset in the SI unit of the signal. A column that the map
does not name keeps its own name, so that a map may be as short as the one column that is wrong.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from experiments.errors import UserError
from experiments.files import first_complaint, parse_json, read_bytes, shown
from experiments.measurement.logs.log import SIGNALS, si_unit, signal_names
from experiments.measurement.logs.log_info import LogInfo
from experiments.measurement.logs.units import to_si

MAX_BYTES: Final = 1_000_000
TOLD: Final = 6  # columns that a message names

Name = Annotated[str, Field(min_length=1, max_length=200)]


class ColumnSource(BaseModel):
    """Where one column of the format comes from."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    from_: Name = Field(alias="from")
    unit: Annotated[str, Field(max_length=40)] | None = None  # None: SI, or what the log's JSON says
    scale: float = 1.0
    offset: float = 0.0


class ColumnMap(BaseModel):
    """Schema of the file. `*` in both names stands for every joint, leg or axis of the signal."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    delimiter: Annotated[str, Field(pattern=r"^[\t !#-~]$")] = ","
    columns: dict[Name, ColumnSource] = {}
    names: dict[Name, Name] = {}


@dataclass(frozen=True)
class Conversion:
    """One column of the format: the file's column, and value -> value * factor + offset."""

    source: str
    factor: float = 1.0
    offset: float = 0.0


def read_column_map(path: Path) -> ColumnMap:
    """A column map from `.toml` or `.json`. Raises UserError in one sentence."""
    data = read_bytes(path, MAX_BYTES)
    if path.suffix == ".json":
        content = parse_json(data, shown(path))
    else:
        try:
            content = tomllib.loads(data.decode())
        except (ValueError, RecursionError) as error:
            raise UserError(f"{shown(path)} is not valid TOML ({shown(str(error))}).") from None
    try:
        return ColumnMap.model_validate(content)
    except ValidationError as error:
        raise UserError(f"{shown(path)}: {first_complaint(error)}.") from None


def conversions(columns: list[str], column_map: ColumnMap, info: LogInfo) -> dict[str, Conversion]:
    """What each column of the format is read from, given the columns of the file.

    Raises UserError where the map names a column that is not there, or that the format does not have.
    """
    mapped = dict(_mapped(column_map, info, columns))
    taken = {conversion.source for conversion in mapped.values()}
    for column in columns:
        if column not in taken and column not in mapped:
            factor = _factor(column, None, info) if signal_of(column) in {*SIGNALS, "time"} else 1.0
            mapped[column] = Conversion(column, factor)
    return mapped


def signal_of(column: str) -> str:
    """`joint_position` of `joint_position/LF_HAA`."""
    return column.partition("/")[0]


def _some(columns: Sequence[str]) -> str:
    """The first few columns, and how many more there are."""
    more = len(columns) - TOLD
    return ", ".join(map(shown, columns[:TOLD])) + (f" and {more} more" if more > 0 else "")


def _mapped(column_map: ColumnMap, info: LogInfo, columns: Sequence[str]) -> Mapping[str, Conversion]:
    result: dict[str, Conversion] = {}
    there = frozenset(columns)
    for target, source in column_map.columns.items():
        expanded = _expanded(target, source.from_, column_map.names, info)
        present = [(column, origin) for column, origin in expanded if origin in there]
        if not present:  # some of the joints may lack, all may not
            origin = shown(source.from_)
            raise UserError(
                f"the column map takes {shown(target)} from '{origin}', which the log does not have; take it "
                f"from one of its columns: {_some(columns)}."
            )
        for column, origin in present:
            factor = _factor(column, source.unit, info) * source.scale
            result[column] = Conversion(origin, factor, source.offset)
    return result


def _expanded(target: str, origin: str, names: Mapping[str, str], info: LogInfo) -> list[tuple[str, str]]:
    signal, _, name = target.partition("/")
    if target != "time" and (signal not in SIGNALS or not name):
        known = ", ".join(("time", *SIGNALS))
        raise UserError(f"the column map names '{shown(target)}'; a column is a signal and a name, signals: {known}.")
    if "*" not in target:
        return [(target, origin)]
    if name != "*" or "*" not in origin:
        raise UserError(f"the column map's '{shown(target)}' needs '*' for the whole name, here and in its 'from'.")
    return [(f"{signal}/{one}", origin.replace("*", names.get(one, one))) for one in signal_names(signal, info.joint)]


def _factor(column: str, unit: str | None, info: LogInfo) -> float:
    signal = signal_of(column)
    unit = unit if unit is not None else info.units.get(signal)
    if unit is None:
        return 1.0
    return to_si(unit, si_unit(signal, info.joint), f"column {shown(column)}")
