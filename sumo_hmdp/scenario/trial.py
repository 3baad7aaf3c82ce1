"""A run that is started and ended at once: whatever SUMO refuses at the start is refused here, in one line."""

from sumo_hmdp.errors import InputError, Problem, SimulationError
from sumo_hmdp.scenario.load import ReadyRun


def start_once(run: ReadyRun, source: str) -> ReadyRun:
    """Return the run after its world has been opened with everybody in it.

    Args:
        run: ready to start.
        source: its file, for the message.

    Raises:
        InputError: the simulation does not start.
    """
    try:
        with run.open_world():
            return run
    except SimulationError as error:
        raise InputError([Problem("", f"the run must start, got: {error}")], source) from error
