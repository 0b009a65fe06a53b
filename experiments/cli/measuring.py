"""`starleth compare`, `diagnose` and `learn`: from a log to a better model."""

import json
from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import EffectsOption, ModelOption, start_jax, whole_loops

LogArgument = Annotated[Path, typer.Argument(help="A log: .csv, .csv.gz, .parquet or .npz, with its .json beside it.")]
LogsArgument = Annotated[list[Path], typer.Argument(help="One or several logs.")]
ColumnsOption = Annotated[Path | None, typer.Option("--columns", help="Column map for logs with other names or units.")]
OutputOption = Annotated[Path | None, typer.Option("--output", "-o", help="Folder for the answer and the report.")]

COMPARE = """Where does the model fail on a log, and by how much over the noise?

Replays each part of the plant on what was measured: the drives on the measured joint motion, the bodies and the ground
on the measured torque; 1.0 is the sensors' noise. A model with effects is shown beside the same model without them.
Prints a table for you and a JSON object for programs, which also tells by how much sensors of one motion are late
against one another, to a fraction of a sample; with -o a report.

    starleth compare log.csv.gz
    starleth compare log.csv.gz --model model.json
"""
DIAGNOSE = """Which physical effect does the model lack, where, how sure, what else could it be?

Scores every known effect at every place, refits the best in the full simulation, proves them on held-out parts of the
logs, and says when it does not know. Writes diagnosis.json and a report. A log that cannot be believed gets the verdict
data_fault with the fault in one sentence; `compare` and `learn` refuse it with that sentence and exit code 2.

    starleth diagnose log.csv.gz
    starleth diagnose air.csv.gz squat.csv.gz --effects my_effect.py
"""
LEARN = """Put an effect into the model file, fitted to logs, with 95 % intervals.

    starleth learn log.csv.gz --effect backlash@LH_KFE
    starleth learn log.csv.gz --effect payload --effect coulomb_friction@all --output model.json
"""


def register(app: typer.Typer) -> None:
    app.command("compare", help=COMPARE)(compare_command)
    app.command("diagnose", help=DIAGNOSE)(diagnose_command)
    app.command("learn", help=LEARN)(learn_command)


def compare_command(
    log: LogArgument,
    model: ModelOption = None,
    effects: EffectsOption = None,
    columns: ColumnsOption = None,
    output: OutputOption = None,
) -> None:
    whole_loops()
    start_jax()
    from experiments.cli.measuring_tables import show_comparison
    from experiments.measurement.checks.delays import signal_delays
    from experiments.measurement.compare import compare
    from experiments.measurement.intake import read_checked
    from experiments.reports.comparison import write_comparison_report
    from experiments.run_folder import make_answer_folder

    robot, library = _model(model, effects)
    taken = read_checked(log, columns, robot)
    robot, library = _on_bench([taken], robot, library)
    if output is not None:
        make_answer_folder(output)
    found = compare(taken, robot, library)
    before = compare(taken, robot.model_copy(update={"effects": ()}), library) if robot.effects else None
    answer = found.answer() | ({"without_effects": before.answer()} if before else {})
    delays = signal_delays(taken, robot.numbers.model_dump(mode="json") if robot.numbers else {})
    answer["sensor_delays"] = [delay.record() for delay in delays]
    show_comparison(found, before)
    if output is not None:
        _write(output, "comparison.json", answer)
        write_comparison_report(output / "report.html", found, before)
    print(json.dumps(answer))


def diagnose_command(
    logs: LogsArgument,
    model: ModelOption = None,
    effects: EffectsOption = None,
    columns: ColumnsOption = None,
    output: OutputOption = Path("diagnosis"),
) -> None:
    whole_loops()
    start_jax()
    from experiments.measurement.diagnose import diagnose
    from experiments.measurement.intake import LogFault, read_checked
    from experiments.measurement.next_experiment import write_commands
    from experiments.reports.data_fault import write_fault_report
    from experiments.reports.diagnosis import write_diagnosis_report
    from experiments.run_folder import make_answer_folder

    robot, library = _model(model, effects)
    try:
        taken = [read_checked(log, columns, robot) for log in logs]
    except LogFault as fault:
        answer = fault.answer()
        make_answer_folder(output)
        _write(output, "diagnosis.json", answer)
        write_fault_report(output / "report.html", fault)
        _say(answer["text"])
        print(json.dumps(answer))
        return
    robot, library = _on_bench(taken, robot, library)
    make_answer_folder(output)
    found = diagnose(taken, robot, library, _say)
    _write(output, "diagnosis.json", found.answer)
    if found.next_experiment.excitation is not None:
        commands = output / "next_experiment.csv"
        write_commands(commands, found.next_experiment.excitation, taken[0].joint_names, taken[0].sample_period)
    write_diagnosis_report(output / "report.html", found)
    _say(found.text)
    print(json.dumps(found.answer))


def learn_command(
    logs: LogsArgument,
    effect: Annotated[list[str], typer.Option("--effect", help="effect@place; may be repeated.")],
    model: ModelOption = None,
    effects: EffectsOption = None,
    columns: ColumnsOption = None,
    nominal: Annotated[bool, typer.Option("--nominal", help="Fit the robot's nominal numbers as well.")] = False,
    output: Annotated[Path, typer.Option("--output", "-o", help="Model file to write.")] = Path("model.json"),
) -> None:
    whole_loops()
    start_jax()
    from experiments.cli.measuring_tables import fitted_lines
    from experiments.errors import UserError
    from experiments.files import refuse_unwritable, shown
    from experiments.measurement.intake import read_checked
    from experiments.measurement.learn import learn, parse_place
    from experiments.model import save_model

    robot, library = _model(model, effects)
    taken = [read_checked(log, columns, robot) for log in logs]
    robot, library = _on_bench(taken, robot, library)
    wanted = [parse_place(text, library, taken[0].joint_names) for text in effect]
    if output.suffix != ".json":
        raise UserError(f"{shown(output)} is no name for a model file; give one that ends in .json.")
    refuse_unwritable(output)
    _say(f"fitting {', '.join(f'{name} at {where}' for name, where in wanted)} to {len(taken)} log(s)")
    learned = learn(taken, robot, library, wanted, nominal)
    save_model(output, learned)
    for line in fitted_lines(learned.effects, wanted):
        _say(line)
    record = learned.provenance[-1]
    for name, error in zip(record["logs"], record["worst_error_over_noise"], strict=True):
        _say(f"{name}: worst channel now at {error:.2f} times the noise")
    _say(f"Written to {output}; next: starleth compare {logs[0]} --model {output}")
    print(json.dumps({"model": str(output), **learned.model_dump(mode="json", include={"effects", "provenance"})}))


def _model(model: Path | None, effects: list[Path] | None):
    from experiments.effects.library import load_effects
    from experiments.model import load_model

    library = load_effects(effects or ())
    return load_model(model, library), library


def _on_bench(logs, model, library):
    """Model and effects for logs: a joint on a bench brings its own numbers, and shows fewer effects."""
    from experiments.measurement.evidence.gather import library_for, model_for, refuse_different_joints

    refuse_different_joints(logs)
    model = model_for(logs[0], model)
    return model, library_for(model, library)


def _write(folder: Path, name: str, answer: dict) -> None:
    from experiments.files import write_json

    write_json(folder / name, answer)


def _say(text: str) -> None:
    typer.echo(text, err=True)
