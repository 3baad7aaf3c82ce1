"""The ledger of a study: one line for each attempt at a run that did not end well."""

import json
from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from sumo_hmdp.study.files import read_bytes
from sumo_hmdp.study.parts import disk
from sumo_hmdp.study.worker import Outcome

# The status of an entry that is no attempt: the run was asked for anew.
AGAIN = "again"


class Ledger:
    """`ledger.jsonl` in a store; a line that a killed process left unfinished is skipped.

    Args:
        folder: the store.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "ledger.jsonl"
        self._attempts: Counter[str] = Counter()
        for entry in read_ledger(folder):
            run_id = str(entry["run_id"])
            self._attempts[run_id] = 0 if entry["status"] == AGAIN else self._attempts[run_id] + 1

    def attempts(self, run_id: str) -> int:
        """Return how often a run has not ended well since it was last asked for anew."""
        return self._attempts[run_id]

    def ask_again(self, run_ids: Iterable[str], reason: str) -> None:
        """Write down that runs are to be done again, so that none of their attempts count.

        Args:
            run_ids: the runs.
            reason: why.
        """
        for run_id in sorted(run_ids):
            self._attempts[run_id] = 0
            self._write({"run_id": run_id, "attempt": 0, "status": AGAIN, "reason": reason})

    def note(self, outcome: Outcome) -> None:
        """Write an attempt down."""
        self._attempts[outcome.run_id] += 1
        self._write(
            {
                "run_id": outcome.run_id,
                "attempt": self._attempts[outcome.run_id],
                "status": str(outcome.status),
                "reason": outcome.reason,
                "wall_time_s": round(outcome.wall_time, 3),
            }
        )

    def _write(self, entry: dict[str, object]) -> None:
        now = datetime.now(tz=UTC).isoformat(timespec="seconds")
        # A line break before it, too: the line before may have no end.
        with disk(), self._path.open("a", encoding="utf-8") as file:
            file.write(f"\n{json.dumps(entry | {'at': now})}\n")


def read_ledger(folder: Path) -> list[dict[str, object]]:
    """Return the entries of a store's ledger, oldest first; what is no whole entry is passed over.

    Raises:
        DamagedFileError: if something else is in its place.
        InputError: if the system does not give it out.
    """
    path = folder / "ledger.jsonl"
    if not path.exists():
        return []
    entries = []
    for line in read_bytes(path).decode(errors="replace").splitlines():
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError):
            continue
        if isinstance(entry, dict) and isinstance(entry.get("run_id"), str) and isinstance(entry.get("status"), str):
            entries.append(entry)
    return entries
