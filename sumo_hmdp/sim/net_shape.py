"""What kind of a network it is where it is no straight road along x: left-hand traffic, a loop, a grid, a curve."""

import math
from collections.abc import Iterator

from sumo_hmdp.errors import Problem
from sumo_hmdp.sim.net_xml import Edge, Lane, Net

# A straight lane turns by no more than this from its first to its last point, rounding aside [rad].
_STRAIGHT = math.radians(1.0)
# Points nearer to each other than this say nothing of the direction [m].
_SHORT = 1.0


def left_hand_mistakes(net: Net) -> Iterator[Problem]:
    """Yield left-hand traffic."""
    if net.left_hand:
        message = 'the network must be for right-hand traffic, got left-hand traffic (lefthand="true"), which is not '
        yield Problem("network", f"{message}simulated. Build it without --lefthand, as its mirror image.")


def shape_mistake(net: Net) -> Problem | None:
    """Return what makes a network another thing than one straight road, in one line; None where nothing does."""
    cycle = _cycle(net)
    if net.roundabouts & set(net.edges):
        return _must_be_road(f"a roundabout (edge {min(net.roundabouts & set(net.edges))})")
    if cycle:
        forks = [edge for edge in cycle if len(_following(net, edge)) > 1]
        if forks:
            ways = ", ".join(sorted(_following(net, forks[0])))
            what = (
                f"streets that meet in a grid or a town ({len(net.edges)} edges; from {forks[0]} one can go to {ways})"
            )
            return _must_be_road(what)
        return _must_be_road(f"a closed loop (edges {', '.join(cycle)})")
    most = max(len(edge.lanes) for edge in net.edges.values())
    for edge in net.edges.values():
        if len(edge.lanes) == most:
            turn = turning(edge.lanes[0])
            if abs(turn) > _STRAIGHT:
                side = "left" if turn > 0.0 else "right"
                return _must_be_road(
                    f"a curve: edge {edge.id} turns to the {side} by {math.degrees(abs(turn)):.0f} deg"
                )
            heading = _heading(edge)
            if abs(heading) > _STRAIGHT:
                return _must_be_road(f"a road at {math.degrees(heading):.0f} deg to x (edge {edge.id})")
    return None


def _must_be_road(what: str) -> Problem:
    return Problem(
        "network", f"the network must be a straight road along x, got {what}. docs/howto/network.md has more."
    )


def turning(lane: Lane) -> float:
    """Return by how much a lane turns away from its first direction at most, positive to the left [rad]."""
    headings = _headings(lane)
    turns = [math.remainder(heading - headings[0], math.tau) for heading in headings]
    return max(turns, key=abs, default=0.0)


def _headings(lane: Lane) -> list[float]:
    points, headings = [lane.shape[0]], []
    for point in lane.shape[1:]:
        dx, dy = point[0] - points[-1][0], point[1] - points[-1][1]
        if math.hypot(dx, dy) >= _SHORT:
            headings.append(math.atan2(dy, dx))
            points.append(point)
    return headings


def _heading(edge: Edge) -> float:
    (x0, y0, *_), (x1, y1, *_) = edge.lanes[0].shape[0], edge.lanes[0].shape[-1]
    return math.atan2(y1 - y0, x1 - x0)


def _following(net: Net, edge: str) -> set[str]:
    return {link.to for link in net.connections if link.edge == edge and not link.turns_back}


def _cycle(net: Net) -> list[str]:
    """Return edges along which one comes back to where one was, empty where there is no such way."""
    following = {name: sorted(_following(net, name)) for name in net.edges}
    done: set[str] = set()
    for first in net.edges:
        path: list[str] = []
        stack = [(first, 0)]
        while stack:
            edge, number = stack.pop()
            if number == 0:
                if edge in done:
                    continue
                path.append(edge)
            if number == len(following[edge]):
                done.add(path.pop())
                continue
            stack.append((edge, number + 1))
            target = following[edge][number]
            if target in path:
                return path[path.index(target) :]
            stack.append((target, 0))
    return []
