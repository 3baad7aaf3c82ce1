"""In which order runs are done."""

from itertools import groupby

from sumo_hmdp.study.runner import SEEDS_AT_ONCE, in_order


def test_a_few_seeds_of_every_cell_come_first_and_cells_with_the_same_traffic_take_turns(tiny):
    # Two planners at each of two speeds of the ego: two worlds.
    seeds = range(SEEDS_AT_ONCE + 2)
    order = list(in_order(tiny.cells, seeds))
    assert sorted((cell.id, seed) for cell, seed in order) == sorted((cell.id, s) for cell in tiny.cells for s in seeds)
    first, second = order[: 4 * SEEDS_AT_ONCE], order[4 * SEEDS_AT_ONCE :]
    assert {seed for _, seed in first} == set(seeds[:SEEDS_AT_ONCE])
    assert {seed for _, seed in second} == set(seeds[SEEDS_AT_ONCE:])
    for part, count in ((first, SEEDS_AT_ONCE), (second, 2)):
        turns = [
            (key, len(list(runs))) for key, runs in groupby(part, lambda run: (run[0].ready.episode.ego.speed, run[1]))
        ]
        assert [n for _, n in turns] == [2] * 2 * count
        assert [speed for (speed, _), _ in turns] == [29.0] * count + [30.0] * count
