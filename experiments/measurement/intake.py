"""Logs on their way in: read, checked for data faults, brought to the control rate."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from experiments.errors import UserError
from experiments.measurement.answer import DATA_FAULT, answer_of
from experiments.measurement.checks.check import check
from experiments.measurement.checks.faults import Fault
from experiments.measurement.evidence.gather import model_for
from experiments.measurement.logs.column_map import read_column_map
from experiments.measurement.logs.log import Log
from experiments.measurement.logs.log_reader import read_log
from experiments.measurement.logs.resample import resample
from experiments.model import Model
from mjx_starleth.numbers import load_numbers


class LogFault(UserError):
    """A log that measures no plant: swapped joints, a wrong unit or sign, a shift, missing samples."""

    def __init__(self, log: Path, faults: Sequence[Fault]) -> None:
        self.log, self.faults = log, tuple(faults)
        super().__init__(f"{log}: {faults[0].message}")

    def answer(self) -> dict[str, Any]:
        """The answer file of a log that cannot be diagnosed."""
        faults = [{"fault": f.fault, "where": f.where, "message": f.message} for f in self.faults]
        return answer_of(DATA_FAULT, str(self), "record the log again without the fault") | {"faults": faults}


def read_checked(path: Path, columns: Path | None, model: Model) -> Log:
    """A log that may be believed, on the ticks of its control. Raises UserError; LogFault for faulty data."""
    log = read_log(path, column_map=read_column_map(columns) if columns else None)
    if log.joint is None and model.joint is not None:
        raise UserError(
            f"{path} is a log of the robot, the model is of the joint {model.joint.name}; give another model."
        )
    numbers = model.numbers or load_numbers()
    faults = check(log, numbers.model_dump(mode="json"))
    if faults:
        raise LogFault(path, faults)
    return resample(log, numbers.loops.control_period if log.joint is None else _bench_period(log, model))


def _bench_period(log: Log, model: Model) -> float:
    """Of a joint on a bench, s: one of the robot's drives runs at the robot's control period, a rigid one as logged."""
    rigid = model_for(log, model).joint.drive == "rigid"
    return log.sample_period if rigid else load_numbers().loops.control_period
