"""Whether SUMO loads a network, tried in a process of its own: on some broken files SUMO ends the process it is in."""

import faulthandler
import os
import tempfile
import warnings
from pathlib import Path

from sumo_hmdp.sim.sumo import IN_WINDOW, libsumo

_SUMO_ERRORS = (libsumo.TraCIException, libsumo.FatalTraCIError)
_FINE, _REFUSED = 0, 3


def load_once(net_file: Path) -> str:
    """Let SUMO load a network and close it again; return why it does not, empty where it does.

    Where a simulation is running in this process nothing is tried: that one has its network.
    """
    if IN_WINDOW or not hasattr(os, "fork") or libsumo.isLoaded():
        return ""
    options = {"net-file": net_file, "no-step-log": "true", "no-warnings": "true"}
    command = ["sumo", *(word for name, value in options.items() for word in (f"--{name}", str(value)))]
    with tempfile.TemporaryFile() as caught:
        with warnings.catch_warnings():
            # The child has one thread, and takes no lock of the others.
            warnings.simplefilter("ignore", DeprecationWarning)
            child = os.fork()
        if child == 0:
            _load_and_exit(command, caught.fileno())
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        caught.seek(0)
        said = caught.read().decode(errors="replace").splitlines()
    if code == _FINE:
        return ""
    lines = [line.removeprefix("Error:").strip() for line in said if line.startswith("Error:")]
    return " ".join(dict.fromkeys(lines)) or f"an end of its process (exit code {code})."


def _load_and_exit(command: list[str], output: int) -> None:
    """Load and close in the child, whose words go to a file; it ends without a trace in the parent."""
    code = _REFUSED
    try:
        # A crash is an answer here: nobody wants its stack.
        faulthandler.disable()
        os.dup2(output, 1)
        os.dup2(output, 2)
        libsumo.start(command)
        libsumo.close()
        code = _FINE
    except _SUMO_ERRORS as error:
        os.write(2, f"Error: {error}\n".encode())
    finally:
        os._exit(code)
