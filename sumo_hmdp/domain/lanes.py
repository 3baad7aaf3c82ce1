"""Lanes of many places at once."""

import numpy as np
from numpy.typing import NDArray

from sumo_hmdp.domain.road import Road


def lanes_at(road: Road, y: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return `Road.lane_at` of many y [m]."""
    lanes = np.rint((road.lane_count + 1) / 2 - y / road.lane_width).astype(np.int64)
    return np.minimum(np.maximum(lanes, 1), road.lane_count)
