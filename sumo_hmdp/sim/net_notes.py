"""What a network says that this package does not use: named, one line a kind, with its first place.

Nothing of it can change a run: what can is obeyed, or refused by `sim/network_checks.py` and its neighbours.
"""

from collections.abc import Iterator
from xml.etree import ElementTree as ET

# What is read, and what only helps to draw a network, or is the same thing a second time.
_KNOWN: dict[str, frozenset[str]] = {
    name: frozenset(attributes.split())
    for name, attributes in {
        "net": "version junctionCornerDetail junctionLinkDetail limitTurnSpeed lefthand walkingareas avoidOverlap "
        "rectangularLaneCut checkLaneFoesAll checkLaneFoesRoundabout tlsIgnoreInternalJunctionJam opposites "
        "internalLinks spreadType higherSpeed",
        "location": "netOffset convBoundary origBoundary projParameter",
        "type": "id priority numLanes speed discard oneway width allow disallow spreadType",
        "restriction": "vClass speed",
        "edge": "id from to function priority type shape spreadType name crossingEdges length bidi distance numLanes "
        "speed allow disallow width",
        "lane": "id index speed length width shape allow disallow changeLeft changeRight customShape acceleration",
        "neigh": "lane",
        "stopOffset": "value vClasses exceptions",
        "tlLogic": "id type programID offset",
        "phase": "duration state minDur maxDur earliestEnd latestEnd next name yellow red vehext",
        "junction": "id type x y z incLanes intLanes shape customShape radius fringe name rightOfWay keepClear",
        "request": "index response foes cont",
        "connection": "from to fromLane toLane via tl linkIndex dir state allow disallow uncontrolled speed length "
        "shape",
        "roundabout": "nodes edges",
        "param": "key value",
    }.items()
}
# Namespaces of the schema have no meaning for a run.
_NAMESPACE = ("{", "xmlns", "xsi:")
_CLASS_NOTE = "permissions of classes other than passenger cars have no effect: to SUMO every vehicle of a run is one"


def notes_of(root: ET.Element) -> tuple[str, ...]:
    """Return what stands in a network and has no effect on a run, one line a kind.

    Args:
        root: XML of the network.
    """
    found: dict[str, list[str]] = {}
    for text, place in (*_unknown(root), *_unused(root)):
        found.setdefault(text, []).append(place)
    return tuple(f"{places[0]}{_others(len(places) - 1)}: {text}" for text, places in found.items())


def _others(count: int) -> str:
    return f" and {count} more" if count else ""


def _unknown(root: ET.Element) -> Iterator[tuple[str, str]]:
    """Yield elements and attributes that no table of this package has."""
    for element in root.iter():
        if not isinstance(element.tag, str):
            continue
        place = f"{element.tag} {element.get('id') or element.get('from') or ''}".strip()
        if element.tag not in _KNOWN:
            yield f"<{element.tag}> is not used, and has no effect on a run", place
            continue
        for name in element.attrib:
            if name not in _KNOWN[element.tag] and not name.startswith(_NAMESPACE):
                yield f"{name} of <{element.tag}> is not used, and has no effect on a run", place


def _unused(root: ET.Element) -> Iterator[tuple[str, str]]:
    """Yield what is known and has no effect."""
    for edge in root.iter("edge"):
        function, place = edge.get("function", "normal"), f"edge {edge.get('id')}"
        if function in {"crossing", "walkingarea"}:
            yield f"a {function} has no effect: nobody walks in a run", place
        for lane in edge.findall("lane"):
            where = f"lane {lane.get('id')}"
            if any(point.count(",") > 1 for point in lane.get("shape", "").split()):
                yield "elevation has no effect: the road is taken to be flat", where
            if function == "normal" and _tells_classes_apart(lane):
                yield _CLASS_NOTE, where


def _tells_classes_apart(lane: ET.Element) -> bool:
    """Tell whether a lane that passenger cars may use is closed to some other class."""
    allow, disallow = lane.get("allow", "").split(), lane.get("disallow", "").split()
    if allow:
        return "all" not in allow and "passenger" in allow
    return bool(disallow) and "all" not in disallow and "passenger" not in disallow
