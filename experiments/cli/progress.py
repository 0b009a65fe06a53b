"""Progress of a search on the terminal: stage, generations, best so far, time left."""

from pathlib import Path
from typing import Any, Self

from rich.console import Console

from es import Descent, Progress, SearchInterrupted
from experiments.cli.bar import INTERRUPTED, Bar
from experiments.distributed import is_first
from experiments.export import Judged
from experiments.refinement import RefinementInterrupted
from experiments.tasks.definition import TaskDefinition


class SearchProgress(Bar):
    """The bar; turns an interrupt into a message that says how to go on."""

    def __init__(self, definition: TaskDefinition, folder: Path, refine: int = 0) -> None:
        self.definition, self.folder, self.refine = definition, folder, refine
        self.refining = None
        super().__init__("best {task.fields[best]}", Console(stderr=True, quiet=not is_first()))

    def __enter__(self) -> Self:
        total = sum(stage.generations for stage in self.definition.stages)
        self.bar.start()
        self.task = self.bar.add_task("compiling", total=total, best="…")
        return self

    def update(self, progress: Progress, aux: Any) -> None:
        """After every generation."""
        last = progress.history[-1]
        name = self.definition.stages[last.stage].name
        self.bar.update(self.task, completed=progress.generations, description=name, best=f"{last.stage_best_cost:.3f}")
        self.say_now_and_then(f"{name}: generation {progress.generations}, best {last.stage_best_cost:.3f}")

    def refined(self, descent: Descent) -> None:
        """After every step of the refinement."""
        if self.refining is None:
            self.refining = self.bar.add_task("refinement", total=self.refine, best="…")
        steps = len(descent.history)
        self.bar.update(self.refining, completed=steps, best=f"{descent.cost:.3f}")
        self.say_now_and_then(f"refinement: step {steps}, cost {descent.cost:.3f}")

    def finish(self, judged: Judged) -> None:
        """One line about the result."""
        self.bar.update(self.task, description="done", completed=self.bar.tasks[0].total)
        self.bar.stop()
        cost, trials = float(judged.nominal.cost), len(judged.trials.cost)
        apex = judged.nominal.metrics.get("apex_height")
        height = "" if apex is None else f"apex {float(apex):.3f} m, "
        self.say(f"{height}cost {cost:.3f}; {judged.successes} of {trials} perturbed trials succeed.")
        if not judged.passed:
            self.say(
                f"NOT passed: with 95 % confidence that shows a success rate of at least {judged.at_least:.1%}, and "
                f"the robustness gate asks for {judged.required:.0%}; the robot's reader refuses this file."
            )
        self.say(f"For the robot: {self.folder}/parameters.json   to look at: {self.folder}/report.html")

    def __exit__(self, kind, error, _) -> bool:
        self.bar.stop()
        if isinstance(error, SearchInterrupted):
            self.say(f"Interrupted after {error.generations} generations; the same command continues the run.")
            raise SystemExit(INTERRUPTED)
        if isinstance(error, RefinementInterrupted):
            self.say(f"Interrupted after {error.steps} steps of the refinement; the same command continues it.")
            self.say(f"The search's result is in {self.folder}/parameters.json.")
            raise SystemExit(INTERRUPTED)
        return False
