"""Progress of perturbed trials on the terminal: done, success so far, time left."""

from pathlib import Path
from typing import Self

from rich.console import Console

from experiments.cli.bar import INTERRUPTED, Bar
from experiments.robustness.file import RobustnessFile


class RobustnessProgress(Bar):
    """The bar; turns an interrupt into a message that says how to go on."""

    def __init__(self, trials: int, folder: Path) -> None:
        self.trials, self.folder, self.done = trials, folder, 0
        super().__init__("{task.fields[success]}", Console(stderr=True))

    def __enter__(self) -> Self:
        self.bar.start()
        self.task = self.bar.add_task("compiling", total=self.trials, success="")
        return self

    def update(self, done: int, successes: int) -> None:
        """After every block of trials."""
        self.done = done
        success = f"{successes / done:.1%} succeed"
        self.bar.update(self.task, completed=done, description="trials", success=success)
        self.say_now_and_then(f"{done} of {self.trials} trials, {success}")

    def finish(self, found: RobustnessFile) -> None:
        """Two lines about the result."""
        self.bar.stop()
        low, high = found.ci95
        rate = f"{found.successes} of {found.trials} trials succeed: {found.success_rate:.2%}"
        self.say(f"{rate} (95 %: {low:.2%} to {high:.2%}).")
        if found.gate is not None:
            verdict = "passed" if found.gate.passed else "NOT passed"
            self.say(f"Robustness gate of {found.gate.required:.1%} {verdict}; {self.folder}/parameters.json says so.")
        self.say(f"{self.folder}/robustness.json   to look at: {self.folder}/report.html")

    def __exit__(self, kind, error, _) -> bool:
        self.bar.stop()
        if isinstance(error, KeyboardInterrupt):
            self.say(f"Interrupted after {self.done} trials, which are kept; the same command continues.")
            raise SystemExit(INTERRUPTED)
        return False
