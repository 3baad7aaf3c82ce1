"""The factors of a study file: values of one path, or named levels that set several paths together."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from sumo_hmdp.errors import Problem
from sumo_hmdp.scenario.schema import ScenarioFile

# Factors that are no path in a scenario, and the option of a single run with which their mistakes are reported.
OPTION_FACTORS = {"planner": "--planner", "solver": "--solver", "risk_level": "--epsilon"}

Factor = Sequence[Any] | Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Setting:
    """One value of a factor: what the tables call it, and what it changes.

    Attributes:
        place: where it stands in the study file.
        value: of the factor; of a named level, its name.
        sets: values by path, planner, solver and risk level among them.
        named: whether it is a named level.
    """

    place: str
    value: Any
    sets: Mapping[str, Any]
    named: bool = False

    def place_of(self, path: str) -> str:
        """Return where the study file gives the value of one of its paths."""
        return f"{self.place}.{path}" if self.named else self.place


def settings_of(name: str, factor: Sequence[Any] | Mapping[str, Mapping[str, Any]]) -> tuple[Setting, ...]:
    """Return the values of a factor: those of a list set its path, named levels set what they list."""
    if isinstance(factor, Mapping):
        return tuple(Setting(f"factors.{name}.{level}", level, sets, named=True) for level, sets in factor.items())
    return tuple(Setting(f"factors.{name}[{i}]", value, {name: value}) for i, value in enumerate(factor))


def factor_problems(factors: Mapping[str, Factor], *, solver_given: bool) -> Iterator[Problem]:
    """Yield what is wrong with factors before any of their values is tried.

    Args:
        factors: by name.
        solver_given: whether one solver is given for all runs.
    """
    setters: dict[str, str] = {}
    for name, factor in factors.items():
        settings = settings_of(name, factor)
        yield from _repeated(settings)
        if isinstance(factor, Mapping) and (name in OPTION_FACTORS or name in ScenarioFile.model_fields or "." in name):
            message = "must be a list of values, or have a name that is no path where its levels are named"
            yield Problem(f"factors.{name}", f"{message}. Write [value, ...] or rename it")
        for path in dict.fromkeys(path for setting in settings for path in setting.sets):
            if path in setters:
                message = f"must not set {path}, which the factor `{setters[path]}` sets. Take it out of one of the two"
                yield Problem(f"factors.{name}", message)
            setters.setdefault(path, name)
    if "solver" in setters and solver_given:
        message = "must not be a factor and given for all runs; remove one of the two"
        yield Problem(f"factors.{setters['solver']}", message)


def _repeated(settings: Sequence[Setting]) -> Iterator[Problem]:
    texts = [json.dumps(setting.sets, sort_keys=True, default=str) for setting in settings]
    for index, (setting, text) in enumerate(zip(settings, texts, strict=True)):
        if text in texts[:index]:
            what = "the same values" if setting.named else json.dumps(setting.value, default=str)
            yield Problem(setting.place, f"must stand once, got {what} again. Remove one")
