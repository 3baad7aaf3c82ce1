"""What a network says is obeyed, refused or noted: made from the shipped networks, one change at a time."""

import gzip
import math
from dataclasses import replace
from pathlib import Path

import pytest

from sumo_hmdp.domain.maneuver import Lateral
from sumo_hmdp.domain.road import Road
from sumo_hmdp.domain.road_rules import NoChange, RoadRules, SpeedZone
from sumo_hmdp.errors import InputError
from sumo_hmdp.sim.net_xml import permits
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.sim.network_rules import rules_in_force

NETWORKS = Path(__file__).parents[3] / "networks"
HIGHWAY, RAMPS, URBAN = (NETWORKS / f"{name}.net.xml" for name in ("highway_3x4m", "highway_ramps", "urban"))
THREE, FOUR = Road(3, 4.0), Road(4, 4.0)
LANE_3 = '<lane id="highway_0"'
LANE_2 = '<lane id="highway_1"'
FIRST, LAST = -1000.0, 9000.0


def made(folder, net, *changes):
    text = net.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "net.xml"
    file.write_text(text)
    return file


def read(folder, net, *changes, road=THREE):
    return read_network(made(folder, net, *changes), road)


@pytest.mark.parametrize(
    ("allow", "disallow", "may"),
    [
        (None, None, True), ("", "", True), ("all", None, True), ("bus taxi", None, False),
        ("bus passenger", None, True),
        (None, "all", False), (None, "passenger", False), (None, "truck bus", True), ("passenger", "passenger", True),
        ("pedestrian", None, False), (None, "pedestrian bicycle", True),
    ],
)  # fmt: skip
def test_permissions_as_sumo_reads_them(allow, disallow, may):
    assert permits(allow, disallow) is may


@pytest.mark.parametrize("rule", ['allow="bus"', 'disallow="all"', 'disallow="passenger truck"', 'allow="rail tram"'])
def test_a_closed_lane_is_none_for_everybody(tmp_path, rule):
    network = read(tmp_path, HIGHWAY, (LANE_3, f"{LANE_3} {rule}"))
    assert network.lane_exists(0.0).tolist() == [True, True, False]
    assert not network.holds(0.0, -4.0)
    assert network.is_closed(0.0, 3)
    # SUMO still counts it.
    assert [network.lane_index(0.0, lane) for lane in (1, 2)] == [2, 1]
    assert network.rules.no_change == (NoChange(2, Lateral.RIGHT, FIRST, LAST),)
    assert "lane 3: closed to passenger cars from -1000 to 9000 m; nobody drives there" in network.notes


def test_a_lane_open_to_cars_but_closed_to_others_is_noted(tmp_path):
    network = read(tmp_path, HIGHWAY, (LANE_3, f'{LANE_3} disallow="truck"'))
    assert network.lane_exists(0.0).all()
    assert network.notes[0].startswith("lane highway_0: permissions of classes other than passenger cars")


def test_solid_lines(tmp_path):
    network = read(tmp_path, HIGHWAY, (LANE_2, f'{LANE_2} changeLeft="authority" changeRight="passenger"'))
    assert network.rules.no_change == (NoChange(2, Lateral.LEFT, FIRST, LAST),)
    assert network.notes == ("lane 2: no change to the left from -1000 to 9000 m; nobody does",)


def test_speed_limits_by_lane_and_stretch(tmp_path):
    network = read(
        tmp_path, RAMPS, ('id="between_1" index="1" speed="60.00"', 'id="between_1" index="1" speed="20.00"'), road=FOUR
    )
    assert [zone for zone in network.rules.speed_zones if zone.lane == 2] == [
        SpeedZone(2, -1000.0, 1800.0, 60.0),
        SpeedZone(2, 1800.0, 3800.0, 20.0),
        SpeedZone(2, 3800.0, 9000.0, 60.0),
    ]
    assert rules_in_force(network, 30.0).speed_limit(2, 2000.0) == 30.0
    assert rules_in_force(network, None).speed_limit(2, 2000.0) == 20.0


def test_the_approach_to_a_limit():
    rules = RoadRules((SpeedZone(1, 100.0, 200.0, 10.0),))
    # v^2 = 10^2 + 2 * 2 * 75 = 20^2.
    assert rules.approach_speed(1, 25.0, 2.0) == pytest.approx(20.0)
    assert rules.approach_speed(1, 150.0, 2.0) == 10.0
    assert (rules.approach_speed(1, 200.0, 2.0), rules.approach_speed(2, 150.0, 2.0)) == (math.inf, math.inf)
    assert rules.allowed_accel(1, 150.0, 10.0, 2.0, 0.2) == 0.0
    assert rules.allowed_accel(1, 150.0, 30.0, 2.0, 0.2) == -4.0
    assert RoadRules().allowed_accel(1, 0.0, 30.0, 2.0, 0.2) == math.inf


def test_a_limit_that_is_none_is_refused(tmp_path):
    for speed in ("0", "-1", "nan", "fast"):
        with pytest.raises(InputError, match=r"speed|could not convert"):
            read(tmp_path, HIGHWAY, (f'{LANE_3} index="0" speed="60.00"', f'{LANE_3} index="0" speed="{speed}"'))


@pytest.mark.parametrize("width", [3.75, 3.25, 3.6576, 2.5, 3.05])
@pytest.mark.parametrize("count", [1, 2, 3, 4, 7])
def test_netconvert_rounds_to_centimetres(tmp_path, width, count):
    lanes = "".join(
        f'<lane id="r_{count - lane}" index="{count - lane}" speed="40" length="4000.00" width="{width:.2f}" '
        f'shape="-500.00,{((count + 1) / 2 - lane) * width:.2f} 3500.00,{((count + 1) / 2 - lane) * width:.2f}"/>'
        for lane in range(count, 0, -1)
    )
    file = tmp_path / "net.xml"
    file.write_text(f'<net><edge id="r">{lanes}</edge></net>')
    for told in (width, round(width, 2)):
        assert read_network(file, Road(count, told)).lane_exists(0.0).sum() == count
    with pytest.raises(InputError, match="lane_width must equal"):
        read_network(file, Road(count, width + 0.05))


def test_a_shifted_road_has_a_remedy_without_sources(tmp_path):
    text = [(f",{y}.00", f",{y - 6}.00") for y in (-4, 0, 4)]
    with pytest.raises(InputError, match=r"must be at y = 0, got y = -6 m. Shift it: netconvert -s .* --offset.y 6"):
        read(tmp_path, HIGHWAY, *text)


def test_a_compressed_network(tmp_path):
    file = tmp_path / "net.xml.gz"
    file.write_bytes(gzip.compress(HIGHWAY.read_bytes()))
    assert replace(read_network(file, THREE), side_limits={}) == read_network(HIGHWAY, THREE)
    file.write_bytes(gzip.compress(HIGHWAY.read_bytes())[:-200])
    with pytest.raises(InputError, match="readable XML"):
        read_network(file, THREE)


def test_a_file_that_is_no_network(tmp_path):
    file = tmp_path / "net.xml"
    file.write_text("<routes/>")
    with pytest.raises(InputError, match="must be a built one, with the root <net>, got <routes>"):
        read_network(file, THREE)


def test_a_sidewalk_and_a_bicycle_lane_are_beside_the_road(tmp_path):
    extra = (
        '<lane id="highway_0" index="0" allow="pedestrian" speed="1.39" length="10000.00" width="2.00" '
        'shape="-1000.00,-8.50 9000.00,-8.50"/><lane id="highway_1" index="1" allow="bicycle" speed="5" '
        'length="10000.00" width="1.50" shape="-1000.00,-6.75 9000.00,-6.75"/>'
    )
    changes = [(f'"highway_{n}" index="{n}"', f'"highway_{n + 2}" index="{n + 2}"') for n in (2, 1, 0)]
    network = read(tmp_path, HIGHWAY, *changes, ('<lane id="highway_2"', extra + '<lane id="highway_2"'))
    assert network.lane_exists(0.0).all()
    assert [network.lane_index(0.0, lane) for lane in (1, 2, 3)] == [4, 3, 2]
    assert "lane highway_0: closed to passenger cars and beside the road; not one of its lanes" in network.notes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("<net ", '<net lefthand="true" '), "left-hand traffic"),
        (('width="4.00" shape="-1000.00,4.00', 'width="3.00" shape="-1000.00,4.00'), "must have one width"),
        (
            ('shape="-1000.00,-4.00 9000.00,-4.00"', 'shape="-1000.00,-4.00 0.00,-4.00 5000.00,900.00 9000.00,-4.00"'),
            "a curve: edge highway turns to the right by 13 deg",
        ),
        (("</net>", '<roundabout nodes="a" edges="highway"/></net>'), "a roundabout"),
        (('id="highway"', 'id="highway" bidi="other"'), "must be one-way"),
    ],
)
def test_what_is_refused(tmp_path, change, message):
    if "roundabout" in change[1]:
        # The ring itself is what is wrong with it: it is named once something is.
        with pytest.raises(InputError, match=message):
            read_network(made(tmp_path, HIGHWAY, change), Road(2, 4.0))
        return
    with pytest.raises(InputError, match=message):
        read(tmp_path, HIGHWAY, change)


def ring(*edges):
    lane = '<edge id="{0}"><lane id="{0}_0" index="0" length="9" speed="9" width="4" shape="0,{1} 9,{1}"/></edge>'
    links = "".join(f'<connection from="{a}" to="{b}" fromLane="0" toLane="0"/>' for a, b in edges)
    names = sorted({name for edge in edges for name in edge})
    return f"<net>{''.join(lane.format(name, 99 + 9 * n) for n, name in enumerate(names))}{links}</net>"


@pytest.mark.parametrize(
    ("edges", "message"),
    [
        ([("a", "b"), ("b", "a")], r"a closed loop \(edges a, b\)"),
        (
            [("a", "b"), ("b", "c"), ("c", "a"), ("b", "d"), ("d", "a")],
            "meet in a grid or a town .* from b one can go to",
        ),
    ],
)
def test_a_loop_and_a_grid_are_named(tmp_path, edges, message):
    file = tmp_path / "net.xml"
    file.write_text(ring(*edges))
    with pytest.raises(InputError, match=message) as caught:
        read_network(file, THREE)
    assert len(caught.value.problems) == 1


@pytest.mark.parametrize("letter", ["G", "O", "r", "u", "y", "Y", "R"])
def test_letters_that_ask_for_nothing(tmp_path, letter):
    assert read(tmp_path, URBAN, ('state="rrrGGGGG"', f'state="rrr{letter * 5}"')).signals


@pytest.mark.parametrize("letter", ["g", "o", "s"])
def test_letters_that_ask_to_yield(tmp_path, letter):
    # Nobody else goes: there is nobody to yield to.
    assert read(tmp_path, URBAN, ('state="rrrGGGGG"', f'state="rrr{letter * 5}"')).signals
    # By its own right of way the arterial yields to nobody, whoever goes.
    free = ('state="rrrGGGGG"', f'state="GGG{letter * 5}"')
    assert read(tmp_path, URBAN, free).signals
    text = URBAN.read_text()
    begin = text.index('<junction id="signal_2"')
    rows = text[begin : text.index("</junction>", begin)]
    # Link 5, the arterial's lane 2, now gives way to links 0 and 1.
    old = next(line for line in rows.splitlines() if 'request index="5"' in line)
    yields = (old, old.replace(old.split('response="')[1].split('"')[0], "00000011"))
    with pytest.raises(InputError, match=f"must have the right of way, got letter '{letter}' in state"):
        read(tmp_path, URBAN, (rows, rows.replace(*yields)), free)


def test_letters_that_nobody_knows(tmp_path):
    with pytest.raises(InputError, match="signal signal_4 must have letters of rRuUyYGOgos, got 'x'"):
        read(tmp_path, URBAN, ('state="rrrGGG"', 'state="rrrGxG"'))
    with pytest.raises(InputError, match="must have a letter for link"):
        read(tmp_path, URBAN, ('state="rrrGGGGG"', 'state="rrr"'))


def test_a_stop_line_before_the_end_of_its_lane_is_refused_at_a_signal(tmp_path):
    lane = (
        '<lane id="arterial_1_1" index="1" speed="13.89" length="600.00" width="4.00" shape="-300.00,0.00 300.00,0.00"'
    )
    offset = (f"{lane}/>", f'{lane}><stopOffset value="5"/></lane>')
    with pytest.raises(InputError, match="lane arterial_1_1 must have its stop line at its end, got stopOffset 5 m"):
        read(tmp_path, URBAN, offset)
    others = (f"{lane}/>", f'{lane}><stopOffset value="5" vClasses="truck"/></lane>')
    assert read(tmp_path, URBAN, others).signals


def test_what_no_table_has_is_noted(tmp_path):
    network = read(tmp_path, HIGHWAY, (LANE_3, f'{LANE_3} surface="ice"'), ("</net>", "<weather/></net>"))
    assert network.notes == (
        "lane highway_0: surface of <lane> is not used, and has no effect on a run",
        "weather: <weather> is not used, and has no effect on a run",
    )


def test_elevation_is_noted(tmp_path):
    network = read(tmp_path, HIGHWAY, (",4.00 9000.00,4.00", ",4.00,12.00 9000.00,4.00,12.00"))
    assert network.notes == ("lane highway_2: elevation has no effect: the road is taken to be flat",)


def test_the_shipped_networks_have_nothing_to_note():
    assert [read_network(net, road).notes for net, road in ((HIGHWAY, THREE), (RAMPS, FOUR), (URBAN, THREE))] == [
        ()
    ] * 3
