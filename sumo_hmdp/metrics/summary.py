"""The numbers of one run, computed from its `steps` and `decisions` tables (docs/metrics.md)."""

from typing import Any

import numpy as np
import pandas as pd

from sumo_hmdp.domain.scene import EGO_ID


def gaps_to_ego(steps: pd.DataFrame) -> pd.DataFrame:
    """Return the gap and the closing speed between the ego and every vehicle whose body is in the ego's lane.

    Args:
        steps: the `steps` table of one run with all vehicles.

    Returns:
        One row per instant and vehicle: time_s, vehicle_id, gap_m (bumper to bumper, negative while they overlap
        along the road) and closing_speed_mps (positive when approaching).
    """
    ego = steps[steps["vehicle_id"] == EGO_ID].set_index("time_s")
    others = steps[steps["vehicle_id"] != EGO_ID]
    columns = ["x_m", "y_m", "speed_mps", "length_m", "width_m"]
    both = others.join(ego[columns].add_suffix("_ego"), on="time_s")
    overlap = (both["y_m"] - both["y_m_ego"]).abs() < (both["width_m"] + both["width_m_ego"]) / 2
    both = both[overlap]
    ahead = both["x_m"] >= both["x_m_ego"]
    gap = np.where(
        ahead,
        both["x_m"] - both["length_m"] - both["x_m_ego"],
        both["x_m_ego"] - both["length_m_ego"] - both["x_m"],
    )
    closing = np.where(ahead, both["speed_mps_ego"] - both["speed_mps"], both["speed_mps"] - both["speed_mps_ego"])
    return pd.DataFrame(
        {
            "time_s": both["time_s"],
            "vehicle_id": both["vehicle_id"],
            "gap_m": gap,
            "closing_speed_mps": closing,
        }
    )


def run_metrics(steps: pd.DataFrame, decisions: pd.DataFrame) -> dict[str, Any]:
    """Summarise one run; a number that is not defined is None.

    Args:
        steps: the `steps` table of one run with all vehicles.
        decisions: its `decisions` table.
    """
    ego = steps[steps["vehicle_id"] == EGO_ID]
    gaps = gaps_to_ego(steps)
    closing = gaps[gaps["closing_speed_mps"] > 0]
    ttc = closing["gap_m"].clip(lower=0.0) / closing["closing_speed_mps"]
    changes = decisions[decisions["lateral"] != "keep"]
    solve_time = decisions["solve_time_ms"]
    count = len(decisions)
    # A rule's decisions are neither optimal nor a departure from it.
    statuses = decisions["status"][decisions["status"] != "rule"]
    shares = {
        f"{status}_share": float((statuses == status).mean()) if len(statuses) else None
        for status in ("optimal", "relaxed", "fallback")
    }
    return {
        "duration_s": float(ego["time_s"].iloc[-1]) if len(ego) else None,
        "distance_m": float(ego["x_m"].iloc[-1] - ego["x_m"].iloc[0]) if len(ego) else None,
        "speed_mean_mps": float(ego["speed_mps"].mean()) if len(ego) else None,
        "gap_min_m": float(gaps["gap_m"].min()) if len(gaps) else None,
        "ttc_min_s": float(ttc.min()) if len(ttc) else None,
        "lane_change_count": len(changes),
        "lane_change_first_s": float(changes["time_s"].iloc[0]) if len(changes) else None,
        "decision_count": count,
        **shares,
        "violation_max_m": float(decisions["violation_m"].max()) if decisions["violation_m"].notna().any() else None,
        "solve_time_median_ms": float(solve_time.median()) if solve_time.notna().any() else None,
        "solve_time_max_ms": float(solve_time.max()) if solve_time.notna().any() else None,
    }
