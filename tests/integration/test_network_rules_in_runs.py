"""Speed limits, closed lanes, solid lines and signals of a network, in runs: SUMO and every planner keep to them."""

from itertools import pairwise
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from sumo_hmdp.cli import app
from sumo_hmdp.domain.road import Road
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, load_scenario
from sumo_hmdp.sim.network import read_network
from sumo_hmdp.study.run import execute

NETWORKS = Path(__file__).parents[2] / "networks"
SIDE_STREET = Path(__file__).parents[1] / "fixtures" / "networks" / "side_street.net.xml"
HIGHWAY = NETWORKS / "highway_3x4m.net.xml"
KEEP = [
    {
        "lateral_probs": {"left": 0.0, "keep": 1.0, "right": 0.0},
        "longitudinal_probs": {"accelerate": 0.1, "cruise": 0.8, "decelerate": 0.1},
    }
]
HMDP = {
    "period_s": 0.6, "horizon_steps": 5, "accel_mps2": 3.0, "speed_min_mps": 0.0, "speed_max_mps": 40.0,
    "stopping": True, "distance_rule": "time_headway", "time_headway_s": 0.0, "safe_distance_m": 8.0,
    "risk_level": 0.05, "risk_allocation": "individual", "followers": "other_lanes", "sequence_threshold": 0.001,
    "action_threshold": 0.02, "maneuver_cost": [[6, 1, 2], [2, 0, 1], [6, 5, 6]], "speed_weight": 6.0,
    "desired_speed_mps": 30.0, "speed_deadband_mps": 0.9,
}  # fmt: skip
PLANNERS = ("hmdp_mpc", "idm_mobil", "sumo", "constant")


def scenario(folder, net, ego, *, vehicles=(), duration=20.0, **more):
    content = {
        "name": "own", "description": "own", "network": str(net), "lanes": {"count": 3, "width_m": 4.0},
        "duration_s": duration, "dt_s": 0.2, "ego": ego, "vehicles": list(vehicles), "planner": "hmdp_mpc",
        "planners": {
            "hmdp_mpc": HMDP, "sumo": {"desired_speed_mps": 30.0}, "idm_mobil": {"desired_speed_mps": 30.0},
            "constant": {},
        },
    }  # fmt: skip
    file = folder / "own.yaml"
    file.write_text(yaml.safe_dump(content | more))
    return file


def vehicle(name, x, lane, speed, driver=None):
    driver = driver or {"kind": "constant_speed"}
    return {"id": name, "x_m": x, "lane": lane, "speed_mps": speed, "driver": driver, "policy": KEEP}


def changed(folder, net, *changes):
    text = net.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "own.net.xml"
    file.write_text(text)
    return file


def run(file, planner):
    return execute(load_scenario(file, RunOptions(planner=planner, solver="search")), detailed=False)


def of(record, name="ego"):
    return record.steps[record.steps["vehicle_id"] == name]


def test_a_red_light_where_nothing_leads_off_the_road(tmp_path):
    ego = {"x_m": 150.0, "lane": 1, "speed_mps": 12.0}
    file = scenario(tmp_path, SIDE_STREET, ego, duration=38.0)
    record = run(file, "hmdp_mpc")
    last = of(record).iloc[-1]
    assert (record.status, record.row["red_light_count"]) == ("completed", 0)
    assert last["speed_mps"] < 1e-3
    assert 290.0 < last["x_m"] < 299.5


@pytest.mark.parametrize("letter", ["O", "o", "g"])
def test_a_signal_that_is_off_lets_the_ego_pass(tmp_path, letter):
    # The arterial gives way to nobody here, whatever its letter.
    states = [("rGGG", f"r{letter * 3}"), ("Grrr", f"r{letter * 3}"), ("ryyy", f"r{letter * 3}"), ("yrrr", "rrrr")]
    net = changed(tmp_path, SIDE_STREET, *((f'state="{old}"', f'state="{new}"') for old, new in states))
    record = run(scenario(tmp_path, net, {"x_m": 150.0, "lane": 2, "speed_mps": 12.0}), "hmdp_mpc")
    assert (record.status, record.row["red_light_count"]) == ("completed", 0)
    assert of(record)["x_m"].max() > 324.0


@pytest.mark.parametrize("planner", ["hmdp_mpc", "idm_mobil", "sumo"])
@pytest.mark.parametrize(
    "change",
    [
        ('<lane id="highway_0"', '<lane id="highway_0" allow="bus"'),
        ('<lane id="highway_1"', '<lane id="highway_1" changeRight="authority"'),
    ],
    ids=["bus lane", "solid line"],
)
def test_nobody_crosses_into_the_right_lane(tmp_path, planner, change):
    net = changed(tmp_path, HIGHWAY, change, ('<lane id="highway_2"', '<lane id="highway_2" disallow="passenger"'))
    ego = {"x_m": 0.0, "lane": 2, "speed_mps": 25.0}
    record = run(scenario(tmp_path, net, ego, vehicles=[vehicle("slow", 60.0, 2, 12.0)], duration=16.0), planner)
    assert record.status == "completed"
    assert set(of(record)["lane"]) == {2}
    assert abs(of(record)["y_m"]).max() < 0.2


def test_a_change_is_made_where_the_line_ends(tmp_path):
    # Solid up to the border at 1500 m, dashed from there on.
    lane = '<lane id="before_merge_1"'
    solid = (lane, f'{lane} changeLeft="authority" changeRight="authority"')
    net = changed(tmp_path, NETWORKS / "highway_ramps.net.xml", solid)
    lanes = {"count": 4, "width_m": 4.0}
    ego = {"x_m": 1300.0, "lane": 2, "speed_mps": 25.0}
    file = scenario(tmp_path, net, ego, vehicles=[vehicle("slow", 1370.0, 2, 15.0)], duration=24.0, lanes=lanes)
    for planner in ("hmdp_mpc", "idm_mobil", "sumo"):
        steps = of(run(file, planner))
        first = steps[abs(steps["y_m"] - 2.0) > 0.9]["x_m"].min()
        assert first > 1500.0, planner


def test_who_starts_in_a_closed_lane_is_refused(tmp_path):
    net = changed(tmp_path, HIGHWAY, ('<lane id="highway_0"', '<lane id="highway_0" allow="bus"'))
    ego = {"x_m": 0.0, "lane": 2, "speed_mps": 25.0}
    with pytest.raises(InputError, match=r"vehicles\[0\].lane: must be open to passenger cars at x = 60.0 m, got 3"):
        load_scenario(scenario(tmp_path, net, ego, vehicles=[vehicle("a", 60.0, 3, 12.0)]))
    with pytest.raises(InputError, match=r"ego.lane: must be open to passenger cars"):
        load_scenario(scenario(tmp_path, net, ego | {"lane": 3}))


@pytest.mark.parametrize("planner", PLANNERS)
def test_every_planner_comes_down_to_a_limit(tmp_path, planner):
    net = changed(tmp_path, HIGHWAY, ('speed="60.00"', 'speed="9.00"'))
    idm = {"kind": "idm", "desired_speed_mps": 30.0}
    ego = {"x_m": 0.0, "lane": 1, "speed_mps": 20.0}
    file = scenario(tmp_path, net, ego, vehicles=[vehicle("a", 30.0, 3, 20.0, idm)], duration=12.0)
    record = run(file, planner)
    assert record.status == "completed"
    for name in ("ego", "a"):
        speeds = of(record, name)["speed_mps"]
        assert speeds.iloc[-1] <= 9.1
        assert speeds.iloc[-1] > 5.0
        # Nobody brakes as in an emergency for a sign.
        assert of(record, name)["accel_mps2"].min() > -6.0
    assert "the network's speed limit is 9 m/s" in record.manifest["network_notes"][0]


TRAFFIC = {
    "density_vpkm_per_lane": 12.0, "stretch_m": [0.0, 1200.0], "warm_up_s": 8.0,
    "belief": KEEP[0] | {"position_var_m2": 0.02, "speed_var_m2ps2": 0.02},
}  # fmt: skip


def test_background_keeps_out_of_a_closed_lane_behind_solid_lines_and_to_the_limit(tmp_path):
    net = changed(
        tmp_path, HIGHWAY, ('speed="60.00"', 'speed="15.00"'),
        ('<lane id="highway_0"', '<lane id="highway_0" allow="bus"'),
        ('<lane id="highway_1"', '<lane id="highway_1" changeLeft="authority"'),
    )  # fmt: skip
    ego = {"x_m": 600.0, "lane": 2, "in_traffic": True}
    record = run(scenario(tmp_path, net, ego, traffic=TRAFFIC, duration=10.0), "idm_mobil")
    others = record.steps[record.steps["vehicle_id"] != "ego"]
    assert len(set(others["vehicle_id"])) > 3
    assert set(others["lane"]) == {1, 2}
    # From lane 2 nobody may go left; nothing keeps those of lane 1 from going right.
    lanes = others.sort_values("step").groupby("vehicle_id")["lane"].agg(list)
    assert not any(a > b for each in lanes for a, b in pairwise(each))
    # Drivers are up to a quarter above a limit, as they are above their class's mean speed.
    assert 10.0 < others["speed_mps"].mean() < 16.5
    assert others["speed_mps"].max() < 1.3 * 15.0
    override = scenario(tmp_path, net, ego, traffic=TRAFFIC | {"speed_limit_mps": 25.0}, duration=2.0)
    faster = run(override, "idm_mobil").steps
    assert faster[faster["vehicle_id"] != "ego"]["speed_mps"].mean() > 18.0


def test_drivers_slow_down_before_a_lower_limit(tmp_path):
    # 30 m/s up to 1500 m, then 15 m/s.
    changes = [(f'id="{e}_{n}" index="{n}" speed="60.00"', f'id="{e}_{n}" index="{n}" speed="{v}"')
               for e, count, v in (("before_merge", 3, 30), ("between", 3, 15)) for n in range(count)]  # fmt: skip
    net = changed(tmp_path, NETWORKS / "highway_ramps.net.xml", *changes)
    ego = {"x_m": 1700.0, "lane": 2, "in_traffic": True}
    traffic = TRAFFIC | {"stretch_m": [1300.0, 2200.0], "lanes": [1, 2, 3]}
    file = scenario(tmp_path, net, ego, traffic=traffic, duration=10.0, lanes={"count": 4, "width_m": 4.0})
    steps = run(file, "idm_mobil").steps
    inside = steps[(steps["x_m"] > 1850.0) & (steps["vehicle_id"] != "ego")]
    assert len(inside) > 50
    assert inside["speed_mps"].max() < 1.3 * 15.0


def check(*arguments):
    return CliRunner().invoke(app, ["check", *arguments])


def test_check_tells_what_the_network_says(tmp_path):
    net = changed(tmp_path, HIGHWAY, ('<lane id="highway_0"', '<lane id="highway_0" allow="bus"'))
    found = check(str(scenario(tmp_path, net, {"x_m": 0.0, "lane": 2, "speed_mps": 25.0})))
    assert found.exit_code == 0
    assert "note: lane 3: closed to passenger cars from -1000 to 9000 m" in found.output


def test_a_network_on_which_sumo_crashes_is_refused_in_one_line(tmp_path):
    # SUMO ends its own process on this one, by a segmentation fault.
    link = next(line for line in (NETWORKS / "urban.net.xml").read_text().splitlines() if 'from=":signal_2_4"' in line)
    net = changed(tmp_path, NETWORKS / "urban.net.xml", (link, ""))
    found = check(str(scenario(tmp_path, net, {"x_m": 0.0, "lane": 2, "speed_mps": 10.0})))
    assert found.exit_code == 2
    assert "network: must be a network that SUMO loads, got:" in found.output


def test_what_sumo_refuses_check_refuses(tmp_path):
    # A junction that names a lane which is not there is no concern of this package, but SUMO does not start.
    net = changed(tmp_path, HIGHWAY, ('incLanes="highway_0 ', 'incLanes="highway_7 '))
    assert read_network(net, Road(3, 4.0)).route == ("highway",)
    found = check(str(scenario(tmp_path, net, {"x_m": 0.0, "lane": 2, "speed_mps": 25.0})))
    assert found.exit_code == 2
    assert "network: must be a network that SUMO loads, got:" in found.output
    assert "Traceback" not in found.output
