"""Commands of `starleth` as results keep them: what repeats a result, ready for the shell."""

import shlex
from collections.abc import Iterable, Mapping
from typing import Final

from experiments.errors import UserError

LONGEST: Final = 1900  # characters: a result's file takes 2000, and some add the number of a trial


def command_line(words: Iterable[object], options: Mapping[str, object]) -> str:
    """`starleth WORDS OPTIONS`, quoted; None and False leave an option away, True stands for an option without a value,
    and a list gives its option once for each entry.

    Raises UserError where the line is longer than a result's file takes.
    """
    line = ["starleth", *map(str, words)]
    for name, value in options.items():
        values = value if isinstance(value, list | tuple) else (value,)
        for one in values:
            if one is not None and one is not False:
                line += [name] if one is True else [name, str(one)]
    text = shlex.join(line)
    if len(text) > LONGEST:
        raise UserError(f"The command that repeats this has {len(text)} characters of {LONGEST}; give shorter paths.")
    return text
