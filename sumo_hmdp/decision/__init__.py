"""Risk, corridors, costs and the solvers that choose the maneuver."""
