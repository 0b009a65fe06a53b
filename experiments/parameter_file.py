"""`parameters.json` written and read: whole, signed, and refused where it is not for this robot.

The checksum is SHA-256 over the canonical form (RFC 8785: keys sorted, no spaces, numbers as in ECMAScript) of
the file without its key `checksum`, so that a reader in any language can verify it.
"""

import hashlib
import math
import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import rfc8785
from pydantic import ValidationError

from experiments.errors import UserError
from experiments.files import first_complaint, read_json, shown, write_json
from experiments.parameter_schema import SCHEMA_VERSION, Parameter, ParameterFile, RobustnessGate
from experiments.robustness.statistics import success_interval

MAX_BYTES: Final = 1_000_000  # a file with every optional part has some 10 kB


def parameter(name: str, value: float, unit: str, low: float, high: float) -> Parameter:
    """A parameter from a float32 search, whose rounding may put it one unit in the last place past its bound.

    Raises ValueError when it lies further outside than that.
    """
    nearest = min(max(value, low), high)
    same_float32 = math.isfinite(value) and struct.pack("f", value) == struct.pack("f", nearest)
    return Parameter(name=name, value=nearest if same_float32 else value, unit=unit, low=low, high=high)


def gate(required: float, successes: int, trials: int, seed: int, perturbations: dict[str, str]) -> RobustnessGate:
    """The verdict on so many trials."""
    low, high = success_interval(successes, trials)
    return RobustnessGate(
        required=required,
        passed=low >= required,
        success_rate=successes / trials,
        ci95=[low, high],
        trials=trials,
        seed=seed,
        perturbations=perturbations,
    )


def now() -> str:
    """The time as it stands in `created`."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def checksum(content: dict[str, Any]) -> str:
    """SHA-256 of the canonical form of the content without its key `checksum`. Raises ValueError (NaN, …)."""
    rest = {key: value for key, value in content.items() if key != "checksum"}
    return hashlib.sha256(rfc8785.dumps(rest)).hexdigest()


def write_parameters(path: Path | str, **fields: Any) -> ParameterFile:
    """Write the fields of `ParameterFile` (all but `schema_version` and `checksum`) atomically; returns the
    file.

    Raises UserError: the disk is full, the folder cannot be written, a number is NaN or out of its bounds.
    """
    try:
        unsigned = ParameterFile(checksum="0" * 64, **fields).model_dump(mode="json")
    except ValidationError as error:
        raise UserError(f"{shown(path)} was not written: {first_complaint(error)}.") from None
    content = unsigned | {"checksum": checksum(unsigned)}
    write_json(path, content)
    return ParameterFile.model_validate(content)


def parameters_at(source: Path) -> Path:
    """The parameter file itself, or that of a run's folder."""
    return source / "parameters.json" if source.is_dir() else source


def read_parameters(
    path: Path | str,
    *,
    robot: str | None = None,
    model_hash: str | None = None,
    task: str | None = None,
    allow_ungated: bool = False,
) -> ParameterFile:
    """Read a parameter file, or refuse it with a UserError of one sentence.

    Refused: a file that is damaged or incomplete, of another schema version, of another robot, model or
    task than asked for, with a value out of bounds, or that has not passed a robustness gate (unless
    `allow_ungated`: for simulation, or by a user who knows).
    """
    content = read_json(path, MAX_BYTES)
    name = shown(path)
    if not isinstance(content, dict) or "schema_version" not in content or "parameters" not in content:
        raise UserError(f"{name} is not a parameter file; give a parameters.json that 'starleth tune' wrote.")
    if content["schema_version"] != SCHEMA_VERSION or type(content["schema_version"]) is not int:
        raise UserError(
            f"{name} has schema version {shown(str(content['schema_version']))}, and this program reads "
            f"{SCHEMA_VERSION}; tune again or use the version of starleth that wrote it."
        )
    try:
        file = ParameterFile.model_validate(content)
        intact = checksum(content) == file.checksum
    except ValidationError as error:
        raise UserError(f"{name} is refused: {first_complaint(error)}; take an undamaged copy or tune again.") from None
    except ValueError as error:  # not representable in RFC 8785
        raise UserError(f"{name} is refused: {error}; take an undamaged copy or tune again.") from None
    if not intact:
        raise UserError(
            f"{name} was changed after it was written (its checksum is wrong); take an undamaged copy or tune again."
        )
    _refuse_other(file, name, robot, model_hash, task)
    if not allow_ungated:
        _refuse_ungated(file, name)
    return file


def _refuse_ungated(file: ParameterFile, name: str) -> None:
    verdict = file.robustness_gate
    if verdict is None:
        raise UserError(
            f"{name} has not been through a robustness gate; run 'starleth robustness {name} --gate 0.99' and take the "
            "file that it writes, or allow ungated files."
        )
    if not verdict.passed:
        raise UserError(
            f"{name} failed its robustness gate ({verdict.success_rate:.1%} of {verdict.trials} trials succeeded, so "
            f"at least {verdict.ci95[0]:.1%} with 95 % confidence; {verdict.required:.1%} required); tune a more "
            "robust motion, or allow ungated files."
        )


def _refuse_other(file: ParameterFile, name: str, robot: str | None, model_hash: str | None, task: str | None) -> None:
    if robot is not None and file.robot != robot:
        raise UserError(f"{name} is for the robot '{file.robot}', not for '{robot}'; tune for this robot.")
    if model_hash is not None and file.model_hash != model_hash:
        raise UserError(
            f"{name} was tuned on the model {file.model_hash}, not on the model in use, {model_hash}; "
            "give the model file it was tuned on, or tune again."
        )
    if task is not None and file.task != task:
        raise UserError(f"{name} is for the task '{file.task}', not for '{task}'; give the file of that task.")
