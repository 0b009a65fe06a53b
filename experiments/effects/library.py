"""The effects that the tool knows, and how a user's own file joins them."""

import importlib.util
from collections.abc import Iterable
from pathlib import Path

from experiments.effects import delay, friction, ground, inertia, link, motor, sensors, transmission
from experiments.effects.effect import Effect
from experiments.effects.rehearsal import refuse_faulty
from experiments.errors import UserError
from experiments.files import shown

MODULES = (friction, motor, delay, transmission, link, inertia, ground, sensors)
LIBRARY: dict[str, Effect] = {effect.name: effect for module in MODULES for effect in module.EFFECTS}


def load_effects(files: Iterable[Path] = ()) -> dict[str, Effect]:
    """The library and the effects of the user's own Python files (each binds EFFECT or EFFECTS).

    The files run as code: they come from the command line only, never from a data file. Raises UserError.
    """
    effects = dict(LIBRARY)
    for path in files:
        for effect in _from_file(Path(path)):
            if effect.name in effects:
                raise UserError(f"{path}: an effect named '{effect.name}' exists already; choose another name.")
            effects[effect.name] = effect
    return effects


def find_effect(name: str, effects: dict[str, Effect]) -> Effect:
    """The effect of that name, or a UserError that lists the names."""
    if name not in effects:
        known = ", ".join(sorted(effects))
        raise UserError(f"No effect '{shown(name)}'; your own come with --effects FILE, the others are {known}.")
    return effects[name]


def _from_file(path: Path) -> tuple[Effect, ...]:
    if not path.is_file():
        raise UserError(f"No effect file {shown(path)}; give the path of your Python file.")
    spec = importlib.util.spec_from_file_location(f"user_effect_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise UserError(f"{path} is not a Python file; an effect file ends in .py.")
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise UserError(f"{shown(path)} does not run: {shown(f'{type(error).__name__}: {error}')}.") from error
    found = getattr(module, "EFFECTS", None) or (getattr(module, "EFFECT", None),)
    if not isinstance(found, tuple | list) or not all(isinstance(effect, Effect) for effect in found):
        raise UserError(f"{path} must bind EFFECT to an experiments.effects.Effect (or EFFECTS to several).")
    try:
        for effect in found:
            refuse_faulty(effect)
    except ValueError as error:
        raise UserError(f"{shown(path)}: {shown(str(error))}.") from error
    return tuple(found)
