"""Mistakes in what a scenario says of its traffic: `check` and `run` tell each with file, key, value and remedy."""

from pathlib import Path

import pytest

SCENARIOS = Path(__file__).parents[2] / "scenarios"
HIGHWAY = (SCENARIOS / "highway.yaml").read_text(encoding="utf-8")
RAMPS = (SCENARIOS / "highway_ramps.yaml").read_text(encoding="utf-8")
CASE2 = (SCENARIOS / "case2.yaml").read_text(encoding="utf-8")
DENSITY = "  density_vpkm_per_lane: 15.0\n"
STRETCH = "stretch_m: [0.0, 2500.0]"
IN_TRAFFIC = "in_traffic: true"
MODES = "{accelerate: 0.0005, cruise: 0.9955, decelerate: 0.004}"
# Nobody moves before the run, so that places are known.
COLD = ("warm_up_s: 20.0", "warm_up_s: 0.0")


def spread(mean, low, high):
    return f"{{mean: {mean}, std: 0.1, min: {low}, max: {high}}}"


def kind(name="car", share=1.0, speed=(30, 25, 35), time_gap=(1.5, 1, 2), politeness=(0.2, 0, 0.5), length=4.5):
    return (
        f"    - {{name: {name}, share: {share}, length_m: {length}, width_m: 1.8, desired_speed_mps: {spread(*speed)}, "
        f"time_gap_s: {spread(*time_gap)}, politeness: {spread(*politeness)}}}\n"
    )


def classes(*kinds):
    return (DENSITY, DENSITY + "  classes:\n" + "".join(kinds))


def also(line):
    """Return the change that adds a line to the section."""
    return (DENSITY, f"{DENSITY}  {line}\n")


def vehicle(name, x):
    return (
        f"\nvehicles:\n  - {{id: {name}, x_m: {x}, lane: 2, speed_mps: 20.0, driver: {{kind: constant_speed}}, "
        "position_var_m2: 0, speed_var_m2ps2: 0, process_position_var_m2: 0, process_speed_var_m2ps2: 0, policy: ["
        "{lateral_probs: {left: 0, keep: 1, right: 0}, "
        "longitudinal_probs: {accelerate: 0, cruise: 1, decelerate: 0}}]}\ntraffic:"
    )


ROAD = "must be within -988..9000 m, where whole vehicles are on the road"
WAY = "must go with a network that has {}; leave it out or change the network"
CAPACITY = "must be at most the capacity of a lane, 1757 vehicles/h, got {}; lower it"
# Name: changes of the highway scenario, and the lines that must come out.
MISTAKES = {
    "a standing density": (
        [(DENSITY, "  density_vpkm_per_lane: 200\n")],
        [
            (
                "traffic.density_vpkm_per_lane: must be below the jam density of a lane, 131.1 vehicles/km, where its "
                "vehicles stand, got 200; lower it"
            )
        ],
    ),
    "a flow over capacity": (
        [(DENSITY, "  flow_vph_per_lane: 3000\n")],
        [f"traffic.flow_vph_per_lane: {CAPACITY.format(3000)}"],
    ),
    "density and flow": (
        [also("flow_vph_per_lane: 300")],
        ["traffic: must have one of density_vpkm_per_lane and flow_vph_per_lane, got both; remove one"],
    ),
    "neither density nor flow": (
        [(DENSITY, "")],
        ["traffic: must have one of density_vpkm_per_lane and flow_vph_per_lane, got neither; add one"],
    ),
    "a negative density": (
        [(DENSITY, "  density_vpkm_per_lane: -1\n")],
        ["traffic.density_vpkm_per_lane: must be at least 0, got -1"],
    ),
    "a stretch backwards": (
        [(STRETCH, "stretch_m: [2000.0, 0.0]")],
        ["traffic.stretch_m: must be [from, to] with from < to, got [2000.0, 0.0]; swap them"],
    ),
    "half a stretch": (
        [(STRETCH, "stretch_m: [2000.0]")],
        ["traffic.stretch_m: must be a list of at least 2, got [2000.0]"],
    ),
    "a stretch before the road": (
        [(STRETCH, "stretch_m: [-2000.0, 2000.0]")],
        [f"traffic.stretch_m: {ROAD}, got [-2000.0, 2000.0]"],
    ),
    "a stretch beyond the road": (
        [(STRETCH, "stretch_m: [8000.0, 9500.0]")],
        [f"traffic.stretch_m: {ROAD}, got [8000.0, 9500.0]"],
    ),
    "a lane that is none": ([also("lanes: [1, 4]")], ["traffic.lanes[1]: must be 1..3, got 4; take it out"]),
    "a lane twice": ([also("lanes: [1, 1]")], ["traffic.lanes: must name a lane once, got [1, 1]; take one out"]),
    "no lane": ([also("lanes: []")], ["traffic.lanes: must be a list of at least 1, got []"]),
    "a warm-up between steps": (
        [("warm_up_s: 20.0", "warm_up_s: 20.1")],
        ["traffic.warm_up_s: must be a multiple of dt_s (0.2 s), got 20.1 s"],
    ),
    "a warm-up of the past": (
        [("warm_up_s: 20.0", "warm_up_s: -1.0")],
        ["traffic.warm_up_s: must be at least 0, got -1.0"],
    ),
    "all distributions of a class": (
        [classes(kind(), kind(share=0.3, speed=(40, 25, 35), time_gap=(1, 0, 2), politeness=(0, -1, 1)))],
        [
            (
                "traffic.classes[1].desired_speed_mps: must have min <= mean <= max, got 25, 40 and 35; "
                "move the mean or the limits"
            ),
            "traffic.classes[1].time_gap_s.min: must be above 0, got 0; raise it",
            "traffic.classes[1].politeness.min: must be at least 0, got -1; raise it",
        ],
    ),
    "shares and names of classes": (
        [classes(kind(share=0.6), kind(share=0.3))],
        [
            "traffic.classes: shares must sum to 1, got 0.9 (car, car). Change a share.",
            "traffic.classes: class names must differ, got car, car. Rename one.",
        ],
    ),
    "a class without length": ([classes(kind(length=0))], ["traffic.classes[0].length_m: must be above 0, got 0"]),
    "a share above 1": ([classes(kind(share=1.5))], ["traffic.classes[0].share: must be at most 1, got 1.5"]),
    "a population": (
        [also("population: rural")],
        ["traffic.population: must be 'highway' or 'urban', got 'rural'"],
    ),
    "passing": (
        [also("lane_changes: {passing: left}")],
        ["traffic.lane_changes.passing: must be 'any_side' or 'left_only', got 'left'"],
    ),
    "measurement": (
        [also("measurement: {position_std_m: -1, speed_std: 1}")],
        [
            "traffic.measurement.position_std_m: must be at least 0, got -1",
            "traffic.measurement.speed_std: unknown key; did you mean `speed_std_mps`?",
        ],
    ),
    "a ramp, a side street and an exit on a network without": (
        [also("ramp_flow_vph: 600\n  side_flow_vph: 600\n  exit_share: 0.1")],
        [
            f"traffic.ramp_flow_vph: {WAY.format('an on-ramp')}",
            f"traffic.side_flow_vph: {WAY.format('a side street')}",
            f"traffic.exit_share: {WAY.format('an off-ramp or a turn')}",
        ],
    ),
    "a ramp over capacity": ([also("ramp_flow_vph: 3000")], [f"traffic.ramp_flow_vph: {CAPACITY.format(3000)}"]),
    "belief": (
        [("keep: 0.98", "keep: 0.9")],
        ["traffic.belief.lateral_probs: must sum to 1, got 0.92"],
    ),
    "a share of courteous drivers above 1, and no patience": (
        [also("courtesy: {share: 1.5, patience_s: -1}")],
        [
            "traffic.courtesy.share: must be at most 1, got 1.5",
            "traffic.courtesy.patience_s: must be at least 0, got -1",
        ],
    ),
    "no belief": (
        [("  belief:", "  beleif:")],
        ["traffic.beleif: unknown key; did you mean `belief`?"],
    ),
    "a belief that leaves nothing to do": (
        [(MODES, "{accelerate: 1.0, cruise: 0.0, decelerate: 0.0}")],
        [
            (
                "traffic.belief.lateral_probs, traffic.belief.longitudinal_probs: must give an admissible action some "
                "probability in every state that is reached, got none in lane 1, mode decelerate (the mode moves by "
                "one level a step); give `keep` or `cruise` some"
            )
        ],
    ),
    "an ego without speed": (
        [(IN_TRAFFIC, "in_traffic: false")],
        ["ego.speed_mps: is missing; add it, or set ego.in_traffic"],
    ),
    "an ego with a speed of its own": (
        [(IN_TRAFFIC, f"{IN_TRAFFIC}\n  speed_mps: 30.0")],
        ["ego.speed_mps: must be left out with ego.in_traffic, got 30 m/s; the ego takes a vehicle's speed"],
    ),
    "an ego in a lane without traffic": (
        [COLD, also("lanes: [1, 3]")],
        [("ego.in_traffic: must be in a lane with background traffic, got lane 2; change ego.lane or the traffic")],
    ),
    "a goal that is passed": (
        [COLD, (IN_TRAFFIC, "in_traffic: false\n  speed_mps: 30.0\n  goal_x_m: 100.0"), ("x_m: 1300.0", "x_m: 3000.0")],
        [
            (
                "ego.goal_x_m: must be ahead of the ego's start at 3000 m and before the road's end at 9000 m, got "
                "100 m; move it, or leave it out"
            )
        ],
    ),
    "noise_scale alone": (
        [("duration_s: 60.0", "duration_s: 60.0\nnoise_scale: 2.0")],
        ["noise_scale: must go with `noise: true`, got 2 without; add the one or remove the other"],
    ),
    "noise_scale 0": (
        [("duration_s: 60.0", "duration_s: 60.0\nnoise: true\nnoise_scale: 0.0")],
        ["noise_scale: must be above 0, got 0.0"],
    ),
    "a described vehicle with a name of the background": (
        [("\ntraffic:", vehicle("bg-2-001", -500))],
        ["vehicles[0].id: must not begin with bg-, as background vehicles do, got 'bg-2-001'; rename it"],
    ),
}


def changed(text, changes):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def refused(call, folder, text):
    """Return what `check` and `run` say alike, and see that nothing was written."""
    file = folder / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    said = []
    for arguments in (["check", file], ["run", file, "--out", folder / "out"]):
        finished = call(*arguments)
        assert (finished.code, finished.out) == (2, "")
        said.append([line.removeprefix(f"{file}: ") for line in finished.lines])
        assert all(line.startswith(f"{file}: ") for line in finished.lines)
    assert said[0] == said[1]
    assert not (folder / "out").exists()
    return said[0]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_the_traffic_is_one_line_with_its_path(call, tmp_path, mistake):
    changes, expected = MISTAKES[mistake]
    assert refused(call, tmp_path, changed(HIGHWAY, changes)) == expected


def test_all_mistakes_of_a_section_at_once(call, tmp_path):
    changes = [(STRETCH, "stretch_m: [9.0, 0.0]"), also("lanes: [1, 4]"), ("warm_up_s: 20.0", "warm_up_s: 20.1")]
    said = refused(call, tmp_path, changed(HIGHWAY, [*changes, (DENSITY, "  density_vpkm_per_lane: 300\n")]))
    paths = [line.split(":")[0] for line in said]
    assert paths == [
        "traffic.stretch_m", "traffic.lanes[1]", "traffic.warm_up_s", "traffic.density_vpkm_per_lane",
    ]  # fmt: skip


def test_an_auxiliary_lane_is_no_lane_for_through_traffic(call, tmp_path):
    (line,) = refused(call, tmp_path, changed(RAMPS, [("  lanes: [1, 2, 3]\n", "")]))
    assert line == (
        "traffic.lanes: must be lanes that exist all along stretch_m, got 4, which does not at -1000 m; list the others"
    )


def test_the_ego_may_not_start_in_a_lane_that_is_not_there(call, tmp_path):
    changes = [("lane: 2\n  in_traffic: true", "lane: 4\n  speed_mps: 20.0"), COLD]
    (line,) = refused(call, tmp_path, changed(RAMPS, changes))
    assert line == "ego.lane: must exist at x = 1000.0 m, got y = -6.0 m. Change the lane or x."


def test_a_described_vehicle_may_not_either(call, tmp_path):
    text = changed(RAMPS, [COLD, ("\ntraffic:", vehicle("mine", -900).replace("lane: 2", "lane: 4"))])
    (line,) = refused(call, tmp_path, text)
    assert line == "vehicles[0].lane: must exist at x = -900.0 m, got 4."


def test_a_place_that_is_taken_is_refused_before_the_run(call, tmp_path):
    from sumo_hmdp.scenario.load import RunOptions, load_scenario  # noqa: PLC0415

    text = changed(
        HIGHWAY, [COLD, (IN_TRAFFIC, "in_traffic: false\n  speed_mps: 30.0"), ("x_m: 1300.0", "x_m: -900.0")]
    )
    (tmp_path / "free.yaml").write_text(text, encoding="utf-8")
    crowd = load_scenario(tmp_path / "free.yaml", RunOptions()).spawns
    taken = next(spawn for spawn in crowd if spawn.lane == 2 and spawn.time == 0.0)
    (line,) = refused(call, tmp_path, text.replace("x_m: -900.0", f"x_m: {taken.x + 1.0!r}"))
    assert line.startswith(f"vehicles: ego and {taken.id} must not start in each other, got an overlap of ")
    # The same for a vehicle that is described.
    text = text.replace("\ntraffic:", vehicle("mine", repr(taken.x + 1.0)))
    (line,) = refused(call, tmp_path, text)
    assert line.startswith(f"vehicles: mine and {taken.id} must not start in each other, got an overlap of ")


def test_vehicles_drawn_from_the_model_need_the_model(call, tmp_path):
    text = changed(
        CASE2, [("duration_s: 45.0", "duration_s: 45.0\nnoise: true"), ("planner: hmdp_mpc", "planner: constant")]
    )
    before, _, after = text.partition("  hmdp_mpc:\n")
    others = after[after.index("\n  idm_mobil:") :] if "\n  idm_mobil:" in after else "\n  constant: {}\n"
    (line,) = refused(call, tmp_path, before + others)
    assert line == "planners.hmdp_mpc: is missing; add it, since `noise` draws the vehicles from its model"
