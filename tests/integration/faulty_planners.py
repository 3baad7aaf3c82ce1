"""A planner that hangs, raises or crashes; the fixture `faulty` offers it as an installed package would."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from sumo_hmdp.decision.baselines import ConstantPlanner
from sumo_hmdp.decision.registry import PlannerKind
from sumo_hmdp.validation import FileModel


class FaultyFile(FileModel):
    fault: Literal["none", "hang", "raise", "segfault", "kill_once", "words"]
    marker: str = ""


@dataclass(frozen=True)
class Faulty:
    inner: Any
    fault: str
    marker: str

    @property
    def period(self):
        return self.inner.period

    def initial_memory(self):
        return self.inner.initial_memory()

    def decide(self, scene, memory):
        if scene.time > 0.2:
            if self.fault == "hang":
                time.sleep(600)
            if self.fault == "raise":
                raise ZeroDivisionError("the planner broke")
            if self.fault == "words":
                raise RuntimeError("the table of errors says [Errno 28] No space left on device")
            if self.fault == "segfault":
                os.kill(os.getpid(), signal.SIGSEGV)
            if self.fault == "kill_once" and not Path(self.marker).exists():
                Path(self.marker).touch()
                os.kill(os.getpid(), signal.SIGKILL)
        return self.inner.decide(scene, memory)


FAULTY = PlannerKind(
    "faulty",
    "breaks",
    FaultyFile,
    lambda parameters, context: Faulty(ConstantPlanner(context.dt), parameters.fault, parameters.marker),
)
