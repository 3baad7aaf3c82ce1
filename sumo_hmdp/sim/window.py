"""SUMO's own window, in which a run can be watched; it needs the `gui` extra."""

import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from sumo_hmdp.domain.scene import EGO_ID

# The variable that makes a process simulate in a window; its value is the pause after each step [ms].
DELAY = "SUMO_HMDP_WINDOW_DELAY_MS"
_ORANGE = (230, 97, 1, 255)
_VIEW = "View #0"
_ZOOM = 1200.0


def program() -> str | None:
    """Return the path of sumo-gui, None where it is not installed."""
    beside = Path(sys.executable).with_name("sumo-gui")
    return str(beside) if beside.is_file() else shutil.which("sumo-gui")


def command(plain: Sequence[str]) -> list[str]:
    """Return SUMO's command line for a window that starts by itself and goes when the run ends."""
    return [program() or "sumo-gui", *plain[1:], "--start", "--quit-on-end", "--delay", os.environ[DELAY]]


def follow_ego(sumo: Any) -> None:  # noqa: ANN401 - TraCI has no types
    """Colour the ego and let the view go with it."""
    sumo.vehicle.setColor(EGO_ID, _ORANGE)
    sumo.gui.setZoom(_VIEW, _ZOOM)
    sumo.gui.trackVehicle(_VIEW, EGO_ID)
