"""Names of cells follow from what is run, and stay what they were."""

from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.identity import content_of


def test_a_section_that_came_later_leaves_the_names_of_cells_without_it():
    without, with_it = (
        load_scenario(find_scenario(name), RunOptions(solver="search")) for name in ("case2", "matched_highway")
    )
    assert "matched_traffic" not in content_of(without)["scenario"]
    assert content_of(with_it)["scenario"]["matched_traffic"]["density_vpkm_per_lane"] == 11.0
