"""Scenario files: schema, loading, and everything that they are checked for.

Importing this package binds it as `sumo_hmdp.scenario`, which is also the name of the function that reads a scenario.
So the module can be called, and is that function.
"""

import sys
from types import ModuleType
from typing import Any

from sumo_hmdp import scenario as _read


class _Callable(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> Any:  # noqa: ANN401 - those of the function
        return _read(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
