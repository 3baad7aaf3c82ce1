"""CommonRoad files of both editions, and the road that lanelets make."""

import math
from dataclasses import replace

import numpy as np
import pytest

from sumo_hmdp.errors import InputError
from sumo_hmdp.tracks.load import Source, read_tracks
from sumo_hmdp.tracks.shape import RoadShape, road_along


def points(xy):
    return "".join(f"<point><x>{x!r}</x><y>{y!r}</y></point>" for x, y in xy)


def lanelet(name, left, right, more=""):
    return (
        f'<lanelet id="{name}"><leftBound>{points(left)}</leftBound><rightBound>{points(right)}</rightBound>'
        f"{more}</lanelet>"
    )


def turned(x, y, angle=0.5):
    return (x * math.cos(angle) - y * math.sin(angle), x * math.sin(angle) + y * math.cos(angle))


def straight():
    """Two lanes of two lanelets each, 200 m long, at 0.5 rad in the file's frame."""
    parts = []
    for name, begin, end, lane in ((1, 0, 100, 0), (2, 0, 100, 1), (3, 100, 200, 0), (4, 100, 200, 1)):
        left, right = ([turned(x, -3.5 * line) for x in (begin, end)] for line in (lane, lane + 1))
        beside = (
            f'<adjacentRight ref="{name + 1}" drivingDir="same"/>'
            if lane == 0
            else f'<adjacentLeft ref="{name - 1}" drivingDir="same"/>'
        )
        follows = f'<successor ref="{name + 2}"/>' if begin == 0 else f'<predecessor ref="{name - 2}"/>'
        parts.append(lanelet(name, left, right, follows + beside))
    return "".join(parts)


def state(tag, k, x, y, position=None):
    where = position or f"<point><x>{x!r}</x><y>{y!r}</y></point>"
    return (
        f"<{tag}><position>{where}</position><orientation><exact>0.5</exact></orientation>"
        f"<time><exact>{k}</exact></time><velocity><exact>10.0</exact></velocity></{tag}>"
    )


RECTANGLE = "<rectangle><length>4.0</length><width>1.8</width></rectangle>"


def moving(name, start, y, edition="2020a", first=0, shape=RECTANGLE, position=None):
    tag = "obstacle" if edition == "2018b" else "dynamicObstacle"
    role = "<role>dynamic</role>" if edition == "2018b" else ""
    states = [turned(start + k, y) for k in range(20)]
    trajectory = "".join(state("state", first + k, *xy) for k, xy in enumerate(states) if k)
    return (
        f'<{tag} id="{name}">{role}<type>car</type><shape>{shape}</shape>'
        f"{state('initialState', first, *states[0], position)}<trajectory>{trajectory}</trajectory></{tag}>"
    )


def file(tmp_path, body, edition="2020a", head=""):
    path = tmp_path / "scene.xml"
    text = f'<commonRoad commonRoadVersion="{edition}" timeStepSize="0.1">{body}</commonRoad>'
    path.write_text(f'<?xml version="1.0"?>{head}{text}')
    return Source(path, "commonroad")


def refusal(source):
    with pytest.raises(InputError) as error:
        read_tracks(source)
    (line,) = error.value.lines()
    return line


@pytest.mark.parametrize("edition", ["2018b", "2020a"])
def test_straight_lanelets_make_s_and_y_exact(tmp_path, edition):
    body = straight() + moving(11, 20.0, -1.75, edition) + moving(12, 60.0, -5.25, edition, first=5)
    traffic = read_tracks(file(tmp_path, body, edition))
    assert (traffic.road.lane_count, traffic.shape.length) == (2, pytest.approx(200.0))
    first = traffic.tracks["11"].at(1.0, traffic.road)
    assert (first.x, first.y, first.heading) == pytest.approx((20.0 + 10.0 + 2.0, 1.75, 0.0), abs=1e-9)
    late = traffic.tracks["12"]
    assert not late.holds(0.4)
    assert late.at(0.5, traffic.road).x == pytest.approx(62.0)


def test_static_obstacles_stand_for_the_whole_record(tmp_path):
    parked = f'<staticObstacle id="13"><type>car</type><shape>{RECTANGLE}</shape>'
    parked += state("initialState", 0, *turned(150.0, -5.25)) + "</staticObstacle>"
    traffic = read_tracks(file(tmp_path, straight() + moving(11, 20.0, -1.75) + parked))
    assert traffic.tracks["13"].at(1.7, traffic.road).x == pytest.approx(152.0)
    assert traffic.tracks["13"].at(1.7, traffic.road).speed == 0.0


def test_uncertain_positions_are_their_centres_and_said_to_be(tmp_path):
    x, y = turned(20.0, -1.75)
    region = f"<circle><radius>0.5</radius><center><x>{x!r}</x><y>{y!r}</y></center></circle>"
    traffic = read_tracks(file(tmp_path, straight() + moving(11, 20.0, -1.75, position=region)))
    assert traffic.tracks["11"].at(0.0, traffic.road).x == pytest.approx(22.0)
    assert traffic.notes == ("1 recorded positions are regions; their centres are used",)


def test_what_is_not_understood_is_named(tmp_path):
    car = straight() + moving(11, 20.0, -1.75)
    bomb = '<!DOCTYPE a [<!ENTITY b "bb"><!ENTITY c "&b;&b;">]>'
    assert "document type" in refusal(file(tmp_path, car, head=bomb))
    assert "2018b, 2020a, got '2017a'" in refusal(file(tmp_path, car, "2017a"))
    assert "got <ellipse>" in refusal(file(tmp_path, straight() + moving(11, 20.0, -1.75, shape="<ellipse/>")))
    assert "lanelets with traffic on them" in refusal(file(tmp_path, straight() + moving(11, 20.0, 30.0)))
    assert "readable XML" in refusal(file(tmp_path, car + "<a>"))
    assert "readable XML" in refusal(file(tmp_path, car, head="<a/>"))


def test_an_obstacle_that_is_no_record_can_be_left_out(tmp_path):
    region = f'<dynamicObstacle id="14"><shape>{RECTANGLE}</shape>{state("initialState", 0, 0.0, 0.0)}<occupancySet/>'
    source = file(tmp_path, straight() + moving(11, 20.0, -1.75) + region + "</dynamicObstacle>")
    assert "obstacle 14 must have a trajectory" in refusal(source)
    assert set(read_tracks(replace(source, leave_out=("14",))).tracks) == {"11"}
    assert "tracks.leave_out[0]: must be a vehicle" in refusal(replace(source, leave_out=("15",)))


def test_a_shape_beside_its_position_is_refused(tmp_path):
    moved = RECTANGLE.replace("</rectangle>", "<center><x>1.5</x><y>0.0</y></center></rectangle>")
    assert "a shape around its position" in refusal(file(tmp_path, straight() + moving(11, 20.0, -1.75, shape=moved)))


def arc(radius, turn, offset, step=2.0):
    """A left bend of a radius, offset to the left."""
    angle = np.linspace(0.0, turn, max(2, round(radius * turn / step)))
    r = radius - offset
    return np.column_stack([r * np.sin(angle), radius - r * np.cos(angle)])


def test_a_bend_keeps_offsets_and_lengths():
    shape = road_along([arc(1000.0, 0.2, d) for d in (3.5, 0.0, -3.5)])
    assert shape.road.lane_count == 2
    inner = arc(1000.0, 0.2, 1.75)[5:-5]
    s, d = shape.locate(*inner.T)
    np.testing.assert_allclose(d, 1.75, atol=0.06)
    # Along an arc a parallel at d is shorter by 1 - curvature d.
    length = np.hypot(*np.diff(inner, axis=0).T).sum()
    assert (s[-1] - s[0]) / length == pytest.approx(1.0 / (1.0 - 1.75 / 1000.0), rel=2e-4)


def test_a_point_is_found_again_from_its_place():
    shape = RoadShape(np.array([[0.0, 0.0], [20.0, 0.0], [40.0, 2.0], [60.0, 6.0]]), np.zeros((2, 4)))
    turn = math.atan2(2.0, 20.0)
    # On the mitred normal of the first inner vertex.
    normal = np.array([-math.sin(turn / 2), math.cos(turn / 2)]) / math.cos(turn / 2)
    x, y = np.array([20.0, 0.0]) + 5.0 * normal
    s, d = shape.locate(np.array([x]), np.array([y]))
    assert (s[0], d[0]) == pytest.approx((20.0, 5.0))


def test_tight_bends_and_turns_are_refused():
    with pytest.raises(InputError, match="curvature times its half width"):
        road_along([arc(100.0, 0.6, d) for d in (7.0, 0.0, -7.0)])
    with pytest.raises(InputError, match=r"must turn by at most|turn back"):
        road_along([arc(300.0, 2.5, d) for d in (3.5, 0.0, -3.5)])
