"""The ledger of a study: one line for each attempt at a run that did not end well."""

import json
from collections import Counter
from datetime import UTC, datetime
from pathlib import Path

from sumo_hmdp.study.parts import disk
from sumo_hmdp.study.worker import Outcome


class Ledger:
    """`ledger.jsonl` in a store; a line that a killed process left unfinished is skipped.

    Args:
        folder: the store.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / "ledger.jsonl"
        self._attempts = Counter(entry["run_id"] for entry in read_ledger(folder))

    def attempts(self, run_id: str) -> int:
        """Return how often a run has not ended well."""
        return self._attempts[run_id]

    def note(self, outcome: Outcome) -> None:
        """Write an attempt down."""
        self._attempts[outcome.run_id] += 1
        entry = {
            "run_id": outcome.run_id,
            "attempt": self._attempts[outcome.run_id],
            "status": str(outcome.status),
            "reason": outcome.reason,
            "wall_time_s": round(outcome.wall_time, 3),
            "at": datetime.now(tz=UTC).isoformat(timespec="seconds"),
        }
        # A line break before it, too: the line before may have no end.
        with disk(), self._path.open("a", encoding="utf-8") as file:
            file.write(f"\n{json.dumps(entry)}\n")


def read_ledger(folder: Path) -> list[dict[str, object]]:
    """Return the entries of a store's ledger, oldest first."""
    path = folder / "ledger.jsonl"
    if not path.is_file():
        return []
    entries = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            entry = json.loads(line)
        except ValueError:
            continue
        if isinstance(entry, dict):
            entries.append(entry)
    return entries
