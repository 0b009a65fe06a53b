"""A bar on stderr; where there is no terminal to draw it on, a line now and then."""

import time

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

INTERRUPTED = 130  # exit code
QUIET = 10.0  # s between lines


class Bar:
    """Description, bar, count, a `field` of the task's own such as '{task.fields[best]}', time gone and time left."""

    def __init__(self, field: str, console: Console) -> None:
        self.console = console
        self.told = time.monotonic()
        self.bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn(field),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
        )

    def say(self, text: str) -> None:
        """A line of its own, whole."""
        self.console.print(text, highlight=False, soft_wrap=True)

    def say_now_and_then(self, text: str) -> None:
        """The same, if there is no bar to be seen and the last line is old enough."""
        if not self.console.is_terminal and time.monotonic() - self.told > QUIET:
            self.told = time.monotonic()
            self.say(text)
