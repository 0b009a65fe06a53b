"""Hostile input to every reader: `python -m experiments.fuzz --count 100000`.

Each input must be read, or be refused with one sentence: no traceback, no hang, no crash, bounded memory. Every
reader is tried in a process of its own; an input is named by its number, which makes it again:
`python -m experiments.fuzz --reader "log npz" --first 4711 --count 1`.
"""

import argparse
import contextlib
import faulthandler
import json
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from experiments.errors import UserError
from experiments.fuzz.readers import READERS, Reader

TIME_LIMIT: Final = 30.0  # s of processor time for one input; a bomb of the largest size takes 5
WAIT_LIMIT: Final = 900.0  # s of any time
MEMORY_LIMIT: Final = 6 << 30  # bytes beyond what the process has when it begins; the largest log fits
LONGEST_SENTENCE: Final = 2_000  # characters


class _TooSlow(BaseException):
    """Not an Exception: no reader may swallow it."""


def problem(reader: Reader, number: int, work: Path) -> str | None:
    """What is wrong with how a reader takes the input of that number; '' if it was read, None if it was refused."""
    folder = work / "input"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    reader.prepare(folder, random.Random(f"{reader.name} {number}"))
    try:
        with _alarm(TIME_LIMIT):
            reader.read(folder)
    except UserError as error:
        return _no_sentence(str(error))
    except _TooSlow:
        return f"took more than {TIME_LIMIT:.0f} s"
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"{type(error).__name__} in {Path(where.filename).name}:{where.lineno}: {str(error)[:200]}"
    return ""


def _no_sentence(text: str) -> str | None:
    """What keeps a message from being one clear sentence."""
    if not text.isprintable():
        return f"not one line of printable text: {text[:200]!r}"
    if len(text) > LONGEST_SENTENCE:
        return f"a sentence of {len(text)} characters: {text[:100]}"
    return None if text.rstrip().endswith((".", "…")) else f"no sentence: {text[-200:]}"


@contextlib.contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def ring(number: int, frame: Any) -> None:
        raise _TooSlow

    before = signal.signal(signal.SIGPROF, ring)
    faulthandler.dump_traceback_later(WAIT_LIMIT, exit=True)  # a hang that Python cannot interrupt
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        faulthandler.cancel_dump_traceback_later()
        signal.signal(signal.SIGPROF, before)


def fuzz(reader: Reader, first: int, count: int, work: Path) -> dict[str, Any]:
    """Inputs `first` to `first + count`: how many were read, refused, and what went wrong with which."""
    ended: Counter[str] = Counter()
    problems: list[str] = []
    slowest = (0.0, first)
    for number in range(first, first + count):
        (work / "number").write_text(str(number))
        began = time.monotonic()
        found = problem(reader, number, work)
        slowest = max(slowest, (time.monotonic() - began, number))
        ended["read" if found == "" else "refused" if found is None else "failed"] += 1
        if found:
            problems.append(f"{number}: {found}")
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    return {
        "reader": reader.name,
        "inputs": count,
        **ended,
        "slowest_s": round(slowest[0], 2),
        "slowest": slowest[1],
        "peak_MB": grown,
        "problems": problems[:20],
    }


def _in_a_process(reader: Reader, first: int, count: int) -> dict[str, Any]:
    """`fuzz`, where a crash takes nothing else with it."""
    with tempfile.TemporaryDirectory(prefix="starleth_fuzz_", dir=_memory()) as work:
        command = [sys.executable, "-m", "experiments.fuzz", "--work", work, "--reader", reader.name]
        command += ["--first", str(first), "--count", str(count)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode in (0, 1) and done.stdout.strip():
            return json.loads(done.stdout.splitlines()[-1])
        with contextlib.suppress(OSError):
            first = int((Path(work) / "number").read_text())
        said = f"{first}: the process ended with {done.returncode}: {done.stderr[-300:]}"
        return {"reader": reader.name, "inputs": count, "failed": 1, "problems": [said]}


def _memory() -> str | None:
    """A folder that is memory, where there is one: a hundred thousand files need no disk."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def _limit_memory() -> None:
    """An allocation beyond the limit fails instead of taking the machine's memory."""
    with open("/proc/self/statm") as statm:
        now = int(statm.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY_LIMIT, resource.RLIM_INFINITY))


def main() -> int:
    names = [reader.name for reader in READERS]
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000, help="inputs of all readers together")
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--reader", choices=names, help="only this one")
    parser.add_argument("--work", type=Path, help=argparse.SUPPRESS)
    words = parser.parse_args()
    if words.work is not None:
        (reader,) = (reader for reader in READERS if reader.name == words.reader)
        reader.prepare(Path(tempfile.mkdtemp(dir=words.work)), random.Random(0))  # imports, before the limit
        with contextlib.suppress(OSError):
            _limit_memory()
        told = fuzz(reader, words.first, words.count, words.work)
        print(json.dumps(told))
        return 1 if told["problems"] else 0
    chosen = [reader for reader in READERS if words.reader in (None, reader.name)]
    share = words.count / sum(1 / reader.heavy for reader in chosen)
    total = failed = 0
    for reader in chosen:
        told = _in_a_process(reader, words.first, max(1, round(share / reader.heavy)))
        print(json.dumps(told), flush=True)
        total, failed = total + told["inputs"], failed + told.get("failed", 0)
    print(json.dumps({"reader": "all", "inputs": total, "failed": failed}))
    return 1 if failed else 0
