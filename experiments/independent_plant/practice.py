"""A robot to practise on: the log of a second StarlETH in which its user has hidden something."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from experiments.errors import UserError
from experiments.independent_plant.generate import write_case
from experiments.independent_plant.library import Effect
from experiments.independent_plant.log_setup import LogSetup
from experiments.independent_plant.play import play_command, refuse_broken
from experiments.independent_plant.runner import PLATFORM, Case, record
from experiments.independent_plant.sensors import SensorSettings

MOTIONS: Final = tuple(motion for motion, platform in PLATFORM.items() if not platform.startswith("bench"))


def parse_hidden(text: str) -> Effect:
    """`backlash@LH_KFE half_width=0.02` as an effect; at the widest place where none is given. Raises UserError."""
    head, *rest = text.split() or [""]
    name, _, where = head.partition("@")
    try:
        parameters = {key: float(value) for key, _, value in (part.partition("=") for part in rest)}
    except ValueError:
        raise UserError(f"'{text}' is no hidden effect; write effect@place parameter=number … .") from None
    try:
        family = Effect(name).family
        where = where or ("all" if "joints" in family.places else family.places[0])
        family(1).add(0, where, parameters, np.random.default_rng(0))
    except ValueError as error:
        raise UserError(f"{error}.") from None
    if not np.isfinite(list(parameters.values())).all():
        raise UserError(f"'{text}': a parameter is no finite number; give one in its unit.")
    if family.scaled not in parameters:
        units = ", ".join(f"{key} [{unit}]" for key, unit in family.units.items())
        raise UserError(f"How much {name}? Give its {family.scaled}; its parameters are {units}.")
    return Effect(name, where, parameters)


def practise(
    motion: str, hidden: Sequence[Effect], log: Path, duration: float = 8.0, seed: int = 0, noise: float = 1.0
) -> bool:
    """Write `<log>.csv.gz` and `<log>.json` of a motion, or of a command file for legs in the air; whether it fell.

    noise: times the usual sensors' noise. Raises UserError.
    """
    sensors = SensorSettings(noise)
    if motion not in MOTIONS:
        if not Path(motion).is_file():
            raise UserError(f"'{motion}' is neither a motion ({', '.join(MOTIONS)}) nor a command file.")
        setup = LogSetup(seed, tuple(hidden), sensors=sensors)
        return bool(play_command(Path(motion), log, setup=setup).fallen[0])
    case = Case(motion, effects=tuple(hidden), seed=seed, duration=duration, sensors=sensors)
    recording = record([case])
    refuse_broken(recording, fixed=PLATFORM[motion] == "fixed_base")
    write_case(log, case, recording)
    return bool(recording.fallen[0])
