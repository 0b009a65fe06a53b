"""Options that say what to search and who takes part: of `tune`, and of `sweep`, which hands some on to its members."""

from pathlib import Path
from typing import Annotated

import typer

from experiments.cli.options import finite

TaskArgument = Annotated[
    str, typer.Argument(help="A task by name (squat_jump, running_trot, …) or your own task file (.json).")
]
StartOption = Annotated[
    Path | None,
    typer.Option("--start", help="A run or a parameters.json, of any model: search on from there, last stage alone."),
]
DriveOption = Annotated[
    str, typer.Option("--drive", help="Drive of the last stages: full, cheap (no current loop) or ideal.")
]
GenerationsOption = Annotated[
    int | None, typer.Option("--generations", min=0, max=1_000_000, help="Generations of all stages.")
]
PopulationOption = Annotated[
    int | None, typer.Option("--population", min=4, max=1_000_000, help="Candidates per generation.")
]
TrialsOption = Annotated[
    int | None, typer.Option("--trials", min=1, max=10_000, help="Perturbed trials per candidate in the last stage.")
]
RiskOption = Annotated[
    str | None,
    typer.Option("--risk", help="What counts over them: their mean (the default), the worst, or cvar (the tail)."),
]
AlphaOption = Annotated[
    float | None,
    typer.Option(
        "--alpha",
        min=0,
        max=0.999,
        callback=finite,
        help="cvar is the mean of the worst share 1 - alpha. Default: 0.75.",
    ),
]
PerturbationsOption = Annotated[
    str | None, typer.Option("--perturbations", help="rough, well_kept, or a file, in place of the task's own.")
]
RefineOption = Annotated[int, typer.Option("--refine", min=0, max=100_000, help="Steps by gradients after the search.")]
RunFolderOption = Annotated[Path | None, typer.Option("--output", "-o", help="Folder of the run. Default: runs/TASK.")]
DistributedOption = Annotated[
    bool, typer.Option("--distributed", help="One of several processes of one search, as the cluster says.")
]
CoordinatorOption = Annotated[
    str | None, typer.Option("--coordinator", help="The same by hand: host:port of process 0.")
]
ProcessesOption = Annotated[int | None, typer.Option("--processes", min=1, help="How many processes there are.")]
ProcessOption = Annotated[int | None, typer.Option("--process", min=0, help="Which of them this is.")]
