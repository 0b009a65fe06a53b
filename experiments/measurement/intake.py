"""Logs on their way in: read, checked for data faults, brought to the control rate."""

from pathlib import Path
from typing import Any

from experiments.errors import UserError
from experiments.measurement.column_map import read_column_map
from experiments.measurement.log import Log
from experiments.measurement.log_reader import read_log
from experiments.model import Model


class LogFault(UserError):
    """A log that measures no plant: swapped joints, a wrong unit or sign, a shift, missing samples."""

    def __init__(self, log: Path, faults: list[Any]) -> None:
        self.faults = faults
        super().__init__(f"{log}: {faults[0].message}")

    def answer(self) -> dict[str, Any]:
        """The answer file of a log that cannot be diagnosed."""
        return {
            "verdict": "data_fault",
            "text": str(self),
            "faults": [{"fault": f.fault, "where": f.where, "message": f.message} for f in self.faults],
            "effects": [],
            "tied_with": [],
            "next_experiment": "record the log again without the fault",
            "unexplained_fraction": 1.0,
            "ranking": [],
        }


def read_checked(path: Path, columns: Path | None, model: Model) -> Log:
    """A log that may be believed. Raises UserError; LogFault where its data cannot be."""
    log = read_log(path, column_map=read_column_map(columns) if columns else None)
    if (log.robot == "joint") != (model.joint is not None or log.robot == "joint"):
        raise UserError(f"{path} is a log of a {log.robot}, the model is another robot's.")
    return log
