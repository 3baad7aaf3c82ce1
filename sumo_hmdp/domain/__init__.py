"""Words of the road: maneuvers, lanes, scenes, plans. Frozen data without behaviour of its own."""
