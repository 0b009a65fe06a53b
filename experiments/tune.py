"""`starleth tune`: search a motion, judge it on unseen trials, write what the robot needs, refine it if asked."""

import contextlib
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from es import (
    CheckpointError,
    Descent,
    Progress,
    Risk,
    SearchResult,
    SearchSettings,
    Stage,
    reduce_costs,
    search,
)
from experiments.batch import local_mesh
from experiments.distributed import checkpointer as make_checkpointer
from experiments.distributed import is_first
from experiments.effects.effect import Effect
from experiments.effects.library import LIBRARY
from experiments.errors import UserError
from experiments.evaluation import Evaluation, crossed
from experiments.export import Judged, export, versions
from experiments.imu_sensing import make_sensing
from experiments.model import Model
from experiments.perturbations import Perturbations, nominal_columns
from experiments.refinement import Refinement, descend, verdict
from experiments.run_folder import RunFolder
from experiments.tasks.definition import TaskDefinition

TAIL = 0.75  # of --risk cvar: the worst quarter of the trials counts
CHUNK = 8  # candidates per device and chunk: a population of 15 fills two devices
UNSEEN_STREAM = 7_919  # trials that judge the result come from another stream than those of the search
JUDGING_TRIALS = 128
GATE = 0.95  # success rate that the judging trials must show, with 95 % confidence: one of 128 may fail


@dataclass(frozen=True)
class TuneOptions:
    """What the user chose."""

    definition: TaskDefinition
    model: Model
    seed: int
    perturbations: Perturbations
    drive: str = "full"  # in place of the full one in every stage that has it
    risk: Risk = field(default_factory=lambda: Risk("mean"))
    library: Mapping[str, Effect] = field(default_factory=lambda: LIBRARY)
    devices: int | None = None
    searched: bool = True  # False: the initial guess stands for the result of a search
    search_law: Perturbations | None = None  # what the search's candidates meet; None: the same
    refine: int = 0  # steps of the refinement, which is an own step after the search: no setting of it
    files: Mapping[str, object] = field(default_factory=dict)  # options that name the user's files a replay needs, too

    def drive_for(self, stage_drive: str) -> str:
        """The drive of a stage that asks for this one."""
        return self.drive if stage_drive == "full" else stage_drive

    def trials(self, key: jax.Array, count: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Perturbed numbers by name and the starts of their sensor noise, (count,) each."""
        return self.perturbations.columns(key, count)

    def search_trials(self, key: jax.Array, count: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """The same for the candidates of the search."""
        return (self.search_law or self.perturbations).columns(key, count)

    @property
    def perturbed_model(self) -> Model:
        """The model with room for the effects that the trials perturb."""
        return self.perturbations.on(self.model, self.library)

    def nominal(self) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """One trial with nothing off, in the same form: the same compiled program runs it."""
        values = nominal_columns(self.perturbations.names, self.model, self.library)
        return {name: np.full(1, value, np.float32) for name, value in values.items()}, np.zeros(1, np.int32)

    def settings(self) -> dict[str, Any]:
        """What decides the result, as JSON values: a run with other settings is another run."""
        settings = {
            "task": self.definition.model_dump(mode="json"),
            "model": self.model.hash(),
            "drive": self.drive,
            "seed": self.seed,
            "risk": str(self.risk),
            "perturbations": self.perturbations.model_dump(mode="json"),
            "versions": versions(),
        }
        if self.search_law not in (None, self.perturbations):
            settings["search_perturbations"] = self.search_law.model_dump(mode="json")
        return settings if self.searched else settings | {"searched": False}


def parse_risk(measure: str, alpha: float | None, definition: TaskDefinition) -> Risk:
    """How a candidate's trials are judged, by the words of the command line. Raises UserError."""
    if measure == "cvar" and alpha is None:
        alpha = TAIL
    try:
        risk = Risk(measure, 0.0 if alpha is None else alpha)
    except ValueError as error:
        raise UserError(f"{error}.") from None
    if measure != "mean" and not any(stage.perturbed and stage.trials > 1 for stage in definition.stages):
        raise UserError(f"--risk {measure} compares several trials of a candidate; give --trials 2 or more.")
    return risk


class StagedEvaluation:
    """`evaluate` of the search: each stage on its own plant, every candidate of a generation on the same trials."""

    def __init__(self, options: TuneOptions) -> None:
        self.options = options
        self.mesh = local_mesh(options.devices)
        self.stages = {stage.name: stage for stage in options.definition.stages}
        self._evaluations: dict[tuple[str, str], Evaluation] = {}

    def on(self, drive: str, sensing: str | None = None) -> Evaluation:
        """The evaluation on a drive, compiled at its first use. sensing: that of the last stage unless given."""
        o = self.options
        drive = o.drive_for(drive)
        sensing = sensing or o.definition.stages[-1].sensing
        if (drive, sensing) not in self._evaluations:
            seen = make_sensing(sensing, o.model)
            self._evaluations[drive, sensing] = Evaluation(
                o.perturbed_model, o.definition, drive, o.library, self.mesh, CHUNK, seen
            )
        return self._evaluations[drive, sensing]

    def compile_ahead(self) -> None:
        """Compile the later stages' programs on another core while the first stage is being compiled and searched."""
        if jax.process_count() > 1:
            return  # these scores would cross with those of the search on their way between the processes
        _, *later = dict.fromkeys((stage.drive, stage.sensing) for stage in self.options.definition.stages)
        guess = self.options.definition.space().initial[None]
        for drive, sensing in later:
            evaluation = self.on(drive, sensing)
            members = crossed(np.repeat(guess, self.options.definition.population, 0), *self.options.nominal())
            threading.Thread(
                target=_in_silence, args=(evaluation.scores, members), daemon=True, name=f"compile {drive}"
            ).start()

    def __call__(self, stage: Stage, candidates: np.ndarray, key: jax.Array) -> tuple[np.ndarray, Any]:
        definition = self.stages[stage.name]
        evaluation = self.on(definition.drive, definition.sensing)
        numbers, noise = (
            self.options.search_trials(key, definition.trials) if definition.perturbed else self.options.nominal()
        )
        score = evaluation.scores(crossed(candidates, numbers, noise), definition.torque_limit)
        costs = score.cost.reshape(len(candidates), -1)
        return np.asarray(reduce_costs(costs, self.options.risk)), score


def _in_silence(function: Callable, *arguments: Any) -> None:
    """What goes wrong here goes wrong again in the search, which tells."""
    with contextlib.suppress(Exception):
        function(*arguments)


def tune(
    options: TuneOptions,
    run: RunFolder,
    on_generation: Callable[[Progress, Any], None],
    notify: Callable,
    on_step: Callable[[Descent], None] = lambda descent: None,
) -> Judged:
    """Search, judge, export, then refine. A run that was interrupted continues from its checkpoint, to the same bits.

    The search's result is on disk and the run finished before a refinement begins.
    Raises UserError, es.SearchInterrupted, RefinementInterrupted.
    """
    evaluation = StagedEvaluation(options)
    result = _searched(options, evaluation, run, on_generation, notify) if options.searched else _guess(options)
    judged = judge(options, evaluation, np.stack([result.best, result.mean]))
    if is_first() and not (run.finished and options.refine):
        export(options, evaluation, run, result, judged)
    run.mark_finished()
    if not options.refine:
        return judged
    found = descend(evaluation, run, judged.values, options.refine, on_step, notify)
    refined = judge(options, evaluation, np.stack([judged.values, found.best])) if found.improved else judged
    kept = found.improved and np.array_equal(refined.values, found.best)
    notify(verdict(found, kept))
    if is_first():
        export(options, evaluation, run, result, refined, Refinement(found, kept))
    return refined


def _guess(options: TuneOptions) -> SearchResult:
    initial = options.definition.space().initial
    return SearchResult(initial, np.inf, initial, (), (), 0, 0)


def _searched(
    options: TuneOptions,
    evaluation: StagedEvaluation,
    run: RunFolder,
    on_generation: Callable[[Progress, Any], None],
    notify: Callable,
) -> SearchResult:
    evaluation.compile_ahead()
    definition = options.definition
    checkpointer = make_checkpointer(run / "checkpoints", {"settings": options.settings()}, notify)
    try:
        return search(
            evaluation,
            definition.space(),
            [Stage(s.name, s.generations, s.drive, sigma_floor=s.sigma_floor) for s in definition.stages],
            SearchSettings(population=definition.population, sigma=definition.sigma),
            jax.random.key(options.seed),
            on_generation,
            checkpointer,
        )
    except CheckpointError as error:
        raise UserError(f"{error}; give another folder with --output, or remove this one.") from None
    except ValueError as error:
        raise UserError(f"{error}.") from None


def judge(options: TuneOptions, evaluation: StagedEvaluation, finalists: np.ndarray) -> Judged:
    """Choose between candidates (F, n) on trials that none has seen: the luckiest and the mean of a search, say."""
    full = evaluation.on(options.definition.stages[-1].drive)
    key = jax.random.fold_in(jax.random.key(options.seed), UNSEEN_STREAM)
    numbers, noise = options.trials(key, JUDGING_TRIALS)
    perturbed = full.scores(crossed(finalists, numbers, noise))
    nominal = full.scores(crossed(finalists, *options.nominal()))
    costs = np.asarray(reduce_costs(perturbed.cost.reshape(len(finalists), -1), options.risk)) + np.asarray(
        nominal.cost
    )
    chosen = int(np.argmin(costs))
    mine = slice(chosen * JUDGING_TRIALS, (chosen + 1) * JUDGING_TRIALS)
    return Judged(
        values=finalists[chosen],
        nominal=jax.tree.map(lambda x: np.asarray(x)[chosen], nominal),
        trials=jax.tree.map(lambda x: np.asarray(x)[mine], perturbed),
        numbers=numbers,
        required=GATE,
    )
