"""Films: which time each frame shows, where everybody is in it, and files that other programs read."""

import json

import numpy as np
import pandas as pd
import pytest
from PIL import Image, ImageSequence

from sumo_hmdp.domain.plan import Status
from sumo_hmdp.errors import InputError
from sumo_hmdp.report import video_file
from sumo_hmdp.report.film import HOLD, film_of
from sumo_hmdp.report.study_figures import STATUS_LOOKS
from sumo_hmdp.report.video import EGO_AT, MARK_COLORS, MARK_NAMES, MARK_SIGNS, STATUS_COLORS, Studio, ticks, write_film
from sumo_hmdp.report.video_file import film_format
from sumo_hmdp.report.video_road import Layout

BLUE = (0, 114, 178)
MANIFEST = {
    "run_id": "r", "scenario": "hand", "planner": "hmdp_mpc", "risk_level": 0.05, "seed": 3, "reason": "",
    "lanes": {"count": 3, "width_m": 4.0},
}  # fmt: skip


def step(number, vehicle_id, x, speed, lane=2):
    return {
        "run_id": "r", "step": number, "time_s": 0.2 * number, "vehicle_id": vehicle_id, "x_m": x,
        "y_m": (2 - lane) * 4.0, "heading_rad": 0.0, "speed_mps": speed, "accel_mps2": 0.0, "lane": lane,
        "intended_lane": lane, "mode": "cruise", "length_m": 4.5, "width_m": 1.8,
    }  # fmt: skip


@pytest.fixture(scope="module")
def steps():
    """The ego at 20 m/s behind a car at 10 m/s; another car is gone after the first instant."""
    rows = [step(k, "ego", 100.0 + 4.0 * k, 20.0) for k in range(6)]
    rows += [step(k, "slow", 150.0 + 2.0 * k, 10.0) for k in range(6)]
    return pd.DataFrame([*rows, step(0, "gone", 90.0, 20.0, lane=1)])


@pytest.fixture(scope="module")
def decisions():
    branch = {
        "vehicle_id": "slow", "probability": 1.0, "lanes": [2], "modes": ["cruise"], "x_m": [160.0], "y_m": [0.0],
        "x_std_m": [1.0], "y_std_m": [0.2],
    }  # fmt: skip
    plan = {"step": 1, "lateral": "keep", "mode": "cruise", "lane": 2, "x_m": 116.0, "speed_mps": 20.0}
    row = {
        "run_id": "r", "decision_index": 0, "time_s": 0.0, "status": "optimal", "reason": "", "lateral": "keep",
        "mode": "cruise", "lane": 2, "objective": 1.0, "violation_m": 0.0, "solver": "search", "solve_time_ms": 1.0,
        "pruned_prob": 0.0, "branch_count": 1, "plan_json": json.dumps([plan]), "branches_json": json.dumps([branch]),
        "forbidden_json": '[{"step": 1, "lane": 2, "x_from_m": 140.0, "x_to_m": Infinity}]',
    }  # fmt: skip
    relaxed = row | {"decision_index": 1, "time_s": 0.8, "status": "relaxed", "reason": "no corridor " * 40}
    relaxed |= {"lateral": "left", "lane": 1}
    return pd.DataFrame([row, relaxed])


@pytest.fixture(scope="module")
def film(steps, decisions, tmp_path_factory):
    made = film_format(tmp_path_factory.mktemp("film") / "run.gif", speed=2.0, fps=10, width=640)
    return film_of(MANIFEST, steps, decisions, made)


def test_frames_show_the_run_at_its_speed_and_hold_its_end(film):
    # 1 s of the run at twice its speed and ten frames a second is a frame each 0.2 s.
    assert film.frame_times == pytest.approx([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, *[1.0] * round(10 * HOLD)])
    assert film.frame_count == 6 + 15


def test_between_instants_everybody_moves_on_a_straight_line(film):
    exact, between = film.at(0.4), film.at(0.25)

    assert dict(zip(exact.ids, exact.x, strict=True)) == {"ego": 108.0, "slow": 154.0}
    assert dict(zip(between.ids, between.x, strict=True)) == pytest.approx({"ego": 105.0, "slow": 152.5})
    assert film.at(0.0).ids == ("ego", "gone", "slow")
    # Between its last instant and the next one a vehicle is nowhere.
    assert film.at(0.1).ids == ("ego", "slow")


def test_the_leader_its_gap_and_the_time_to_collision(film):
    name, gap, ttc = film.at(0.4).leader()

    assert (name, gap, ttc) == ("slow", pytest.approx(154 - 4.5 - 108), pytest.approx((154 - 4.5 - 108) / 10))


def test_decision_in_force_and_marks(film):
    assert film.at(0.79).decision["status"] == "optimal"
    assert film.at(0.8).decision["status"] == "relaxed"
    assert film.marks == ((0.8, "left"), (0.8, "relaxed"))


def test_the_ego_is_drawn_where_it_is(film):
    frame, layout = Studio(film).frame(0.4), Layout(640, 3)

    assert frame.size == (640, layout.height)
    assert layout.height % 2 == 0
    per_m = 640 / layout.span
    middle = layout.head + layout.road / 2
    inside = (EGO_AT * layout.span - 2.0) * per_m
    assert frame.getpixel((round(inside), round(middle))) == BLUE
    assert frame.getpixel((round(inside), round(middle - layout.lane))) != BLUE
    behind = (EGO_AT * layout.span - 4.5 - 1.0) * per_m
    assert frame.getpixel((round(behind), round(middle))) != BLUE


def test_a_gif_has_every_frame(film, tmp_path):
    seen = []
    write_film(tmp_path / "new" / "run.gif", film, lambda done, total: seen.append((done, total)))

    with Image.open(tmp_path / "new" / "run.gif") as image:
        shown = sum(frame.info["duration"] for frame in ImageSequence.Iterator(image))
        assert image.size == (640, Layout(640, 3).height)
    # Pillow joins equal frames; the time is what counts.
    assert shown == 100 * film.frame_count
    assert seen == [(k, film.frame_count) for k in range(1, film.frame_count + 1)]
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["run.gif"]


def test_an_mp4_is_read_back(steps, decisions, tmp_path):
    av = pytest.importorskip("av")
    path = tmp_path / "run.mp4"
    film = film_of(MANIFEST, steps, decisions, film_format(path, fps=20, width=641))
    write_film(path, film)

    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.codec_context.name, stream.average_rate) == ("h264", 20)
    assert len(frames) == film.frame_count
    drawn = np.asarray(Studio(film).frame(0.0)).astype(float)
    assert frames[0].shape == drawn.shape == (Layout(640, 3).height, 640, 3)
    assert np.mean(np.abs(frames[0] - drawn)) < 5


def test_every_wrong_option_is_named_at_once(tmp_path, monkeypatch):
    monkeypatch.setattr(video_file.importlib.util, "find_spec", lambda name: None)

    with pytest.raises(InputError) as raised:
        film_format(tmp_path / "run.mp4", speed=0.0, fps=100, width=10)

    assert [line.split(":")[0] for line in raised.value.lines()][:3] == ["--speed", "--fps", "--width"]
    assert "pip install 'sumo-hmdp[video]'" in raised.value.lines()[3]
    with pytest.raises(InputError, match=r"must end in \.mp4 or \.gif"):
        film_format(tmp_path / "run.avi")


def test_a_gif_keeps_hundredths_of_a_second(tmp_path):
    assert film_format(tmp_path / "run.gif", fps=30).fps == pytest.approx(100 / 3)
    assert film_format(tmp_path / "run.gif").width == 800


def test_a_run_without_instants_cannot_be_filmed(tmp_path, decisions):
    with pytest.raises(InputError, match="must have instants to film"):
        film_of(MANIFEST, pd.DataFrame(), decisions, film_format(tmp_path / "run.gif"))


@pytest.mark.parametrize(
    ("low", "high", "most", "expected"), [(0.0, 60.0, 8, [0, 10, 20, 30, 40, 50, 60]), (9.6, 10.6, 4, [10.0, 10.5])]
)
def test_ticks_are_round_numbers(low, high, most, expected):
    assert ticks(low, high, most) == pytest.approx(expected)


def test_every_status_has_its_looks():
    """A status that is new must get a colour, a bar and, where it departs from the best plan, a mark."""
    assert set(STATUS_COLORS) == set(STATUS_LOOKS) == set(Status)
    departures = {str(status) for status in Status if status.departs}
    assert departures == {"incumbent", "relaxed", "fallback"}
    assert departures <= set(MARK_NAMES) == set(MARK_SIGNS)
    assert set(MARK_NAMES) <= set(MARK_COLORS)
