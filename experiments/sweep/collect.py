"""The members of a sweep side by side: what each found, what each cost, who failed and why."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from experiments.errors import UserError
from experiments.parameter_schema import ParameterFile
from experiments.run_folder import RUN_FILE
from experiments.sweep.definition import MEMBERS, Member, Sweep, label
from experiments.sweep.member import INTERRUPTED, read_outcome, result_of

Status = Literal["finished", "unfinished", "failed", "damaged", "not begun"]
SCHEMA_VERSION: Final = 1
SUCCESS: Final = "success"


@dataclass(frozen=True)
class Row:
    """One member; `file` and the figures only where it is finished."""

    member: Member
    status: Status
    sentence: str = ""
    file: ParameterFile | None = None
    seconds: float | None = None

    @property
    def cost(self) -> float | None:
        """Cost of the nominal trial."""
        return self.figure("cost")

    @property
    def success_rate(self) -> float | None:
        """Share of the perturbed judging trials that succeed."""
        if self.file is None or SUCCESS not in self.file.metrics:
            return None
        spread = self.file.metrics[SUCCESS].spread
        return None if spread is None else spread.mean

    def figure(self, name: str) -> float | None:
        """A metric of the nominal trial."""
        if self.file is None or name not in self.file.metrics:
            return None
        return float(self.file.metrics[name].value)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        member, file = self.member, self.file
        return {
            "name": member.name,
            "task": label(member.task),
            "model": label(member.model),
            "seed": member.seed,
            "status": self.status,
            "sentence": self.sentence,
            "seconds": self.seconds,
            "parameters": f"{MEMBERS}/{member.name}/parameters.json" if file else None,
            "model_hash": file.model_hash if file else None,
            "checksum": file.checksum if file else None,
            "cost": self.cost,
            "success_rate": self.success_rate,
            "metrics": {name: metric.value for name, metric in file.metrics.items()} if file else {},
            "values": file.values() if file else {},
        }


def collect(folder: Path, sweep: Sweep) -> list[Row]:
    """A row for every member, in the sweep's order; reads only, so it may run while the sweep does."""
    return [_row(folder, member) for member in sweep.members()]


def _row(folder: Path, member: Member) -> Row:
    outcome = read_outcome(folder, member.name)
    seconds = outcome.seconds if outcome else None
    try:
        file = result_of(folder, member.name)
    except UserError as error:
        return Row(member, "damaged", str(error), None, seconds)
    if file is not None:
        return Row(member, "finished", "", file, seconds)
    if outcome is not None and outcome.exit_code not in (0, INTERRUPTED):
        return Row(member, "failed", outcome.sentence, None, seconds)
    begun = (folder / MEMBERS / member.name / RUN_FILE).exists()
    return Row(member, "unfinished" if begun else "not begun", "", None, seconds)


def best_rows(rows: list[Row]) -> list[Row]:
    """The finished member of least cost for each task and model."""
    best: dict[tuple[str, str], Row] = {}
    for row in rows:
        key = (row.member.task, row.member.model)
        if row.cost is not None and (key not in best or row.cost < best[key].cost):
            best[key] = row
    return list(best.values())


def summary(rows: list[Row]) -> dict[str, Any]:
    """The contents of `sweep.json`."""
    counts = {status: sum(row.status == status for row in rows) for status in Status.__args__}
    return {
        "schema_version": SCHEMA_VERSION,
        "members": [row.as_dict() for row in rows],
        "counts": counts,
        "best": [row.member.name for row in best_rows(rows)],
    }


def shared_metrics(rows: list[Row], most: int = 3) -> list[str]:
    """Metrics worth a column: numbers that every finished member has and that are not all the same."""
    finished = [row.file for row in rows if row.file is not None]
    if not finished:
        return []
    names = [
        name
        for name, metric in finished[0].metrics.items()
        if name != "cost" and isinstance(metric.value, float) and all(name in file.metrics for file in finished)
    ]
    return [name for name in names if len({file.metrics[name].value for file in finished}) > 1 or len(finished) == 1][
        :most
    ]
