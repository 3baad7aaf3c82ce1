"""Why runs of studies ended in a contact: each of them is done again and told in one row.

Reads what `sumo-hmdp study NAME --out DIR` has left, does every run that ended in a contact again (its trace must be
the stored one), and prints a page in Markdown: counts by planner and kind, then the runs. `sumo-hmdp replay DIR RUN_ID`
shows any of them.

    python analysis/11_contacts.py results/highway_planners results/matched_planners --page docs/contacts.md
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

import sumo_hmdp
from sumo_hmdp.domain.scene import EGO_ID, VehicleState
from sumo_hmdp.sim.contact import Side
from sumo_hmdp.sim.episode import Moment
from sumo_hmdp.study.again import run_again, stored_run

# How far back the motion across the road is looked at: by then a lane change of 4 s has moved a body by a metre [s].
BEFORE = 1.6
# Who has moved less across the road in that time keeps its lane [m].
STILL = 0.2
# A lane change that is over for longer has nothing to do with a contact from behind or ahead [s].
RECENT = 5.0

HEAD = """# Contacts

Written by `python analysis/11_contacts.py DIR ... --page docs/contacts.md`: every run of the studies {studies}
that ended in a contact, done again with the same trace. `sumo-hmdp replay DIR RUN_ID` shows one.
*At fault* is the rule of docs/contact-rules.md: the ego moved into the other.
"""


@dataclass(frozen=True)
class Told:
    """One run that ended in a contact.

    Attributes:
        study: its name.
        planner: who drove.
        run_id: its name.
        time: of the contact [s].
        other: whom the ego touched.
        at_fault: by the rule.
        kind: what happened, in words.
        speed: of the ego [m/s].
        other_speed: of the other [m/s].
    """

    study: str
    planner: str
    run_id: str
    time: float
    other: str
    at_fault: bool
    kind: str
    speed: float
    other_speed: float


class Story:
    """The instants of a run as far as a contact needs them."""

    def __init__(self) -> None:
        self.moments: list[Moment] = []

    def note(self, moment: Moment) -> None:
        """Keep an instant."""
        self.moments.append(moment)

    def vehicle(self, name: str, back: float) -> VehicleState | None:
        """Return a vehicle some time before the end [s], None where it was not in sight."""
        end = self.moments[-1].scene.time
        scene = min((m.scene for m in self.moments), key=lambda scene: abs(end - back - scene.time))
        return next((v for v in (scene.ego, *scene.others) if v.id == name), None)

    def moves(self, name: str) -> bool:
        """Tell whether a vehicle has moved across the road just before the end."""
        before, now = self.vehicle(name, BEFORE), self.vehicle(name, 0.0)
        return before is not None and now is not None and abs(now.y - before.y) > STILL

    def has_changed(self, name: str) -> bool:
        """Tell whether a vehicle was in another lane a short time before the end."""
        road = self.moments[-1].scene.road
        before, now = self.vehicle(name, RECENT), self.vehicle(name, 0.0)
        return before is not None and now is not None and road.lane_at(before.y) != road.lane_at(now.y)

    def kind(self, other: str, side: Side) -> str:
        """Return what happened."""
        ego_moves, other_moves = self.moves(EGO_ID), self.moves(other)
        if side is Side.SIDE:
            who = {
                (True, True): "both come over, into the same lane",
                (True, False): "the ego comes over",
                (False, True): "the other comes over",
            }
            return who.get((ego_moves, other_moves), "side by side")
        changed = [name for name, vehicle in (("the ego", EGO_ID), ("the other", other)) if self.has_changed(vehicle)]
        after = f", after {' and '.join(changed)} changed lanes" if changed else ""
        return ("the other runs into the ego's rear" if side is Side.REAR else "the ego runs into the other") + after


def told(folder: Path, row: pd.Series) -> Told:
    """Do a run again and tell its contact."""
    story = Story()
    record = run_again(stored_run(folder, str(row["run_id"])), story.note)
    if record.row["trace_hash"] != row["trace_hash"]:
        raise SystemExit(f"{row['run_id']} must have the trace that is stored. Use the version that made {folder}")
    last = story.moments[-1]
    contact = last.contacts[0]
    other = story.vehicle(contact.other_id, 0.0)
    return Told(
        study=folder.name,
        planner=str(row["planner"]),
        run_id=str(row["run_id"]),
        time=last.scene.time,
        other=contact.other_id,
        at_fault=contact.at_fault,
        kind=story.kind(contact.other_id, contact.side),
        speed=last.scene.ego.speed,
        other_speed=float("nan") if other is None else other.speed,
    )


def page(folders: list[Path]) -> str:
    """Return the page."""
    stories, lines, runs = [], [], 0
    for folder in folders:
        table = sumo_hmdp.load(folder).runs
        runs += len(table)
        stories += [told(folder, row) for _, row in table[table["contact_count"] > 0].iterrows()]
    lines += [HEAD.format(studies=", ".join(f"`{folder.name}`" for folder in folders))]
    lines += [
        f"{len(stories)} of {runs} runs.\n",
        "| study | planner | what happened | runs | at fault |",
        "|---|---|---|---|---|",
    ]
    frame = pd.DataFrame([vars(story) for story in stories])
    for (study, planner, kind), group in frame.groupby(["study", "planner", "kind"]):
        lines.append(f"| {study} | `{planner}` | {kind} | {len(group)} | {int(group['at_fault'].sum())} |")
    lines += [
        "\n## The runs\n",
        "| RUN_ID | t [s] | with | what happened | at fault | ego [m/s] | other [m/s] |",
        "|---|---|---|---|---|---|---|",
    ]
    for s in sorted(stories, key=lambda one: (one.study, one.planner, one.run_id)):
        fault = "yes" if s.at_fault else "no"
        lines.append(
            f"| `{s.run_id}` | {s.time:.1f} | {s.other} | {s.kind} | {fault} | {s.speed:.1f} | {s.other_speed:.1f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    """Read studies and write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folders", nargs="+", type=Path, metavar="DIR", help="of a study")
    parser.add_argument("--page", type=Path, help="where to write it; printed where it is not given")
    options = parser.parse_args()
    text = page(options.folders)
    if options.page is None:
        print(text)
    else:
        options.page.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
