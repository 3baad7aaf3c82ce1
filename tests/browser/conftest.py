"""A synthetic run to look at: an ego that overtakes on three lanes, and a browser to look with."""

import json
import math
import shutil
from collections.abc import Callable, Iterator
from typing import Any

import pandas as pd
import pytest

DT, PERIOD, DURATION, HORIZON = 0.15, 0.6, 45.0, 8
LANE_COUNT, LANE_WIDTH = 3, 4.0
CHANGE_S = 3.0
# id: x at the start, speed, swing of the speed, lane, lane changes as (start, new lane), length.
TRAFFIC: dict[str, tuple[float, float, float, int, tuple[tuple[float, int], ...], float]] = {
    "car_01": (62.0, 20.0, 0.8, 2, (), 4.6),
    "car_02": (-28.0, 24.5, 1.0, 1, (), 4.3),
    "car_03": (38.0, 21.5, 0.6, 3, ((31.0, 2),), 4.5),
    "truck_04": (112.0, 18.0, 0.3, 3, (), 12.0),
    "car_05": (170.0, 27.5, 1.4, 1, (), 4.5),
    "car_06": (-52.0, 23.0, 1.0, 3, ((14.0, 2),), 4.2),
    "car_07": (205.0, 22.5, 0.9, 2, (), 4.8),
}
EGO_CHANGES = ((7.2, 1), (21.6, 2))


def lane_y(lane: int) -> float:
    return ((LANE_COUNT + 1) / 2 - lane) * LANE_WIDTH


def lateral(time: float, lane: int, changes: tuple[tuple[float, int], ...]) -> tuple[float, float, int]:
    """y, dy/dt and the intended lane at a time: every lane change is a quintic blend."""
    y, slope, intended = lane_y(lane), 0.0, lane
    for start, target in changes:
        s = min(max((time - start) / CHANGE_S, 0.0), 1.0)
        rise = lane_y(target) - y
        if time >= start:
            intended = target
            slope = rise * 30 * s * s * (1 - s) ** 2 / CHANGE_S
            y += rise * (10 * s**3 - 15 * s**4 + 6 * s**5)
    return y, slope, intended


def ego_accel(time: float) -> float:
    return -0.9 if 4.8 <= time < 7.2 else 1.1 if 7.2 <= time < 12.6 else -0.7 if 24.0 <= time < 28.2 else 0.0


def ego_track(frame_count: int) -> list[tuple[float, float, float]]:
    x, speed, track = 0.0, 24.0, []
    for frame in range(frame_count):
        accel = ego_accel(frame * DT)
        track.append((x, speed, accel))
        x += speed * DT + accel * DT * DT / 2
        speed += accel * DT
    return track


def mode_of(accel: float) -> str:
    return "accelerate" if accel > 0.25 else "decelerate" if accel < -0.25 else "cruise"


def row(step: int, vehicle_id: str, x: float, speed: float, accel: float, lane: int, changes, length: float):
    time = step * DT
    y, slope, intended = lateral(time, lane, changes)
    return {
        "run_id": "overtaking",
        "step": step,
        "time_s": time,
        "vehicle_id": vehicle_id,
        "x_m": x,
        "y_m": y,
        "heading_rad": math.atan2(slope, speed),
        "speed_mps": speed,
        "accel_mps2": accel,
        "lane": round((LANE_COUNT + 1) / 2 - y / LANE_WIDTH),
        "intended_lane": intended,
        "mode": mode_of(accel),
        "length_m": length,
        "width_m": 2.5 if length > 8 else 1.8,
    }


def steps_table() -> pd.DataFrame:
    frame_count = round(DURATION / DT) + 1
    rows = []
    track = ego_track(frame_count)
    for step in range(frame_count):
        rows.append(row(step, "ego", *track[step], 2, EGO_CHANGES, 4.5))
        time = step * DT
        for i, (vehicle_id, (x, speed, swing, lane, changes, length)) in enumerate(TRAFFIC.items()):
            w = 0.22 + 0.03 * i
            # The last car leaves before the end.
            if vehicle_id == "car_05" and time > 38:
                continue
            rows.append(
                row(
                    step,
                    vehicle_id,
                    x + speed * time + swing / w * (1 - math.cos(w * time)),
                    speed + swing * math.sin(w * time),
                    swing * w * math.cos(w * time),
                    lane,
                    changes,
                    length,
                )
            )
    return pd.DataFrame(rows)


def branch(state, probability: float, accel: float, lane_change: int) -> dict[str, Any]:
    target = min(max(state.lane + lane_change, 1), LANE_COUNT)
    x, y, speed = [], [], state.speed_mps
    for k in range(1, HORIZON + 1):
        t = k * PERIOD
        x.append(state.x_m + speed * t + accel * t * t / 2)
        y.append(state.y_m + (lane_y(target) - state.y_m) * min(t / CHANGE_S, 1.0))
    return {
        "vehicle_id": state.vehicle_id,
        "probability": probability,
        "lanes": [target] * HORIZON,
        "modes": [mode_of(accel)] * HORIZON,
        "x_m": x,
        "y_m": y,
        "x_std_m": [0.35 + 0.22 * k for k in range(HORIZON)],
        "y_std_m": [0.12 + 0.03 * k for k in range(HORIZON)],
    }


def forbidden(branches: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [
        {
            "step": k + 1,
            "lane": one["lanes"][k],
            "x_from_m": one["x_m"][k] - 14.5 - 2 * one["x_std_m"][k],
            "x_to_m": one["x_m"][k] + 14.5 + 2 * one["x_std_m"][k],
        }
        for one in branches
        if one["probability"] > 0.1
        for k in range(HORIZON)
    ]


def plan(ego, time: float) -> list[dict[str, Any]]:
    # The lane that it intended before the decision.
    entries, x, speed, before = [], ego.x_m, ego.speed_mps, lateral(time - DT / 2, 2, EGO_CHANGES)[2]
    for k in range(1, HORIZON + 1):
        accel = ego_accel(time + (k - 1) * PERIOD)
        x += speed * PERIOD + accel * PERIOD**2 / 2
        speed += accel * PERIOD
        # Sums of periods are not exact.
        lane = lateral(time + (k - 1) * PERIOD + 1e-9, 2, EGO_CHANGES)[2]
        move = "left" if lane < before else "right" if lane > before else "keep"
        entries.append({"step": k, "lateral": move, "mode": mode_of(accel), "lane": lane, "x_m": x, "speed_mps": speed})
        before = lane
    return entries


def decision(index: int, time: float, ego, others) -> dict[str, Any]:
    status = "fallback" if 33.0 <= time < 34.3 else "relaxed" if 5.3 <= time < 7.0 or 30.5 <= time < 33.0 else "optimal"
    branches = []
    for other in others:
        if abs(other.x_m - ego.x_m) > 110:
            continue
        away = -1 if other.lane == 3 else 1
        branches += [branch(other, 0.72, 0.0, 0), branch(other, 0.2, -0.9, 0), branch(other, 0.06, 0.0, away)]
    planned = [] if status == "fallback" else plan(ego, time)
    reasons = {
        "optimal": "",
        "relaxed": "no corridor keeps every distance: the least violation is 0.84 m at step 3, lane 2",
        "fallback": "contact could not be excluded within the horizon; braking in lane 2",
    }
    return {
        "run_id": "overtaking",
        "decision_index": index,
        "time_s": time,
        "status": status,
        "reason": reasons[status],
        "lateral": planned[0]["lateral"] if planned else "keep",
        "mode": planned[0]["mode"] if planned else "decelerate",
        "lane": planned[0]["lane"] if planned else 2,
        "objective": None if status == "fallback" else 412.7 - 3.1 * index,
        "violation_m": {"optimal": 0.0, "relaxed": 0.84, "fallback": None}[status],
        "solver": "highs",
        "solve_time_ms": 18.4 + 7 * math.sin(index),
        "pruned_prob": 0.02,
        "branch_count": len(branches),
        "plan_json": json.dumps(planned),
        "branches_json": json.dumps(branches),
        "forbidden_json": json.dumps(
            [*forbidden(branches), {"step": 1, "lane": 3, "x_from_m": -1e9, "x_to_m": ego.x_m - 30}]
        ),
    }


def decisions_table(steps: pd.DataFrame) -> pd.DataFrame:
    every = round(PERIOD / DT)
    rows = []
    for index in range(int(DURATION / PERIOD)):
        scene = list(steps[steps["step"] == index * every].itertuples())
        ego = next(state for state in scene if state.vehicle_id == "ego")
        others = [state for state in scene if state.vehicle_id != "ego"]
        rows.append(decision(index, index * every * DT, ego, others))
    return pd.DataFrame(rows)


@pytest.fixture(scope="session")
def manifest() -> dict[str, Any]:
    return {
        "run_id": "overtaking-hmdp-7",
        "scenario": "overtaking",
        "planner": "hmdp",
        "seed": 7,
        "dt_s": DT,
        "period_s": PERIOD,
        "duration_s": DURATION,
        "status": "completed",
        "reason": "",
        "trace_hash": "5f1c0b7e9a3d4427b1f0c8e2d6a94b35",
        "lanes": {"count": LANE_COUNT, "width_m": LANE_WIDTH},
        "horizon_steps": HORIZON,
        "risk_level": 0.05,
        "safe_distance_m": 10.0,
        "cost": {"weights": {"speed": 1.0, "lane": 0.3}, "desired_speed_mps": 30.0},
        "versions": {"sumo_hmdp": "0.1.0", "sumo": "1.28.0", "highs": "1.15.1"},
    }


@pytest.fixture(scope="session")
def steps() -> pd.DataFrame:
    return steps_table()


@pytest.fixture(scope="session")
def decisions(steps: pd.DataFrame) -> pd.DataFrame:
    return decisions_table(steps)


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A headless Chromium or Chrome of this machine; nothing is downloaded."""
    names = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
    executable = next((path for name in names if (path := shutil.which(name))), None)
    if executable is None:
        pytest.skip(f"no browser on the PATH: looked for {', '.join(names)}")
    from playwright.sync_api import sync_playwright  # noqa: PLC0415 - only where there is a browser

    # Each launch makes a fresh profile.
    arguments = [
        "--no-sandbox",
        "--disable-gpu",
        "--disable-quic",
        "--no-first-run",
        "--disable-background-networking",
        "--disable-component-update",
        "--disable-sync",
    ]
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=executable, headless=True, args=arguments)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[..., Any]]:
    """Open a file in a fresh context; what the console or the page complains about fails the test."""
    complaints: list[str] = []
    contexts = []

    def open_file(path: Any, fragment: str = "", **options: Any) -> Any:
        context = browser.new_context(**{"viewport": {"width": 1280, "height": 900}, **options})
        contexts.append(context)
        page = context.new_page()
        page.on(
            "console",
            lambda message: complaints.append(message.text) if message.type in {"error", "warning"} else None,
        )
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request",
            lambda request: None if request.url.startswith("file:") else complaints.append(request.url),
        )
        page.goto(path.as_uri() + fragment)
        # A replay unpacks its data first; other pages have nothing to wait for.
        page.evaluate("window.replayReady")
        return page

    yield open_file
    for context in contexts:
        context.close()
    assert complaints == []
