"""A polite kill is an interrupt: what Ctrl-C leaves resumable, SIGTERM does, too."""

import signal
import threading
from typing import Any


def terminate_as_interrupt() -> None:
    """From now on SIGTERM raises KeyboardInterrupt in the main thread. Does nothing in any other thread."""

    def interrupt(number: int, frame: Any) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, interrupt)
