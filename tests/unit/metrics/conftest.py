"""Small traces for the tests of metrics, as a fixture: the tests are no package, so they cannot import one another."""

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.trace import trace_of

DEFAULTS = {
    "y_m": 0.0,
    "heading_rad": 0.0,
    "speed_mps": 10.0,
    "accel_mps2": 0.0,
    "lane": 2,
    "intended_lane": 2,
    "length_m": 4.0,
    "width_m": 2.0,
}
SHORT = {name.split("_")[0]: name for name in DEFAULTS} | {"intended": "intended_lane"}


def steps_frame(time, **vehicles):
    """Build a steps table; each vehicle is a dict of x, and what is not standard, numbers or one for each instant."""
    parts = []
    for name, given in vehicles.items():
        columns = DEFAULTS | {SHORT.get(key, key): value for key, value in given.items() if key != "x"}
        parts.append(pd.DataFrame({"time_s": time, "vehicle_id": name, "x_m": given["x"]}).assign(**columns))
    table = pd.concat(parts, ignore_index=True)
    return table[table["x_m"].notna()]


def run_data(time, desired_speed=None, **vehicles):
    """Build what metrics are computed from."""
    return RunData(trace_of(steps_frame(np.array(time, dtype=float), **vehicles)), pd.DataFrame(), desired_speed)


@pytest.fixture(scope="session")
def run_of():
    """The function run_of(time, desired_speed, vehicle=dict(x, ...), ...): what metrics are computed from."""
    return run_data
