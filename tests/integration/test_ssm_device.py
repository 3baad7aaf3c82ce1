"""Time to collision and needed deceleration against SUMO's own surrogate safety measures, in car-following."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from sumo_hmdp.metrics.catalogue import METRICS
from sumo_hmdp.metrics.registry import RunData
from sumo_hmdp.metrics.safety import drac, ttc
from sumo_hmdp.metrics.trace import trace_of

RUN = Path(__file__).with_name("ssm_run.py")
# SUMO gives two decimals; its DRAC follows from a gap that it does not round.
ROUNDED = 0.005 + 1e-9


def driven(folder, braking_from):
    """Return the rows of a drive, and its `steps` table."""
    call = [sys.executable, "-P", str(RUN), str(folder), str(braking_from)]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    rows = json.loads(done.stdout)
    bodies = {"ego": (4.0, 1.8), "leader": (9.0, 2.4)}
    steps = [
        {
            "time_s": row["time_s"], "vehicle_id": name, "x_m": row[name][0], "y_m": 0.0, "heading_rad": 0.0,
            "speed_mps": row[name][1], "accel_mps2": 0.0, "lane": 2, "intended_lane": 2, "length_m": length,
            "width_m": width,
        }
        for row in rows
        for name, (length, width) in bodies.items()
    ]  # fmt: skip
    return rows, RunData(trace_of(pd.DataFrame(steps)), pd.DataFrame())


def numbers(rows, name):
    """Return what SUMO said, NaN where it had nothing to say."""
    return np.array([float(row[name]) if row[name] else math.nan for row in rows])


def test_car_following_as_the_device_sees_it(tmp_path):
    rows, run = driven(tmp_path, braking_from=4.7)
    least = np.minimum.accumulate(ttc(run.trace)[:, 0])
    most = np.maximum.accumulate(drac(run.trace)[:, 0])
    said = numbers(rows, "minTTC")
    closed = np.isfinite(least)
    assert closed.sum() > 100
    assert np.isnan(said[~closed]).all()
    assert said[closed] == pytest.approx(least[closed], abs=ROUNDED)
    assert numbers(rows, "maxDRAC") == pytest.approx(most, abs=ROUNDED)
    # Neither scene nor device was asleep: a conflict by SUMO's thresholds of 3 s and 3 m/s2.
    assert said[-1] < 3.0 < numbers(rows, "maxDRAC")[-1]
    assert METRICS.get("ttc_min_s").compute(run) == pytest.approx(said[-1], abs=ROUNDED)
    assert METRICS.get("drac_max_mps2").compute(run) == pytest.approx(numbers(rows, "maxDRAC")[-1], abs=ROUNDED)
    assert METRICS.get("gap_min_m").compute(run) > 0.0


def test_known_differences_in_a_contact(tmp_path):
    rows, run = driven(tmp_path, braking_from=5.0)
    assert METRICS.get("gap_min_m").compute(run) < 0.0
    assert (METRICS.get("ttc_min_s").compute(run), numbers(rows, "minTTC")[-1]) == (0.0, 0.0)
    assert METRICS.get("drac_max_mps2").compute(run) == math.inf
    before = drac(run.trace)[:, 0]
    assert numbers(rows, "maxDRAC")[-1] == pytest.approx(before[np.isfinite(before)].max(), abs=ROUNDED)
