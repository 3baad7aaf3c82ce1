"""Case 2 in motion: both planners one above the other, as an animated GIF that is drawn without a display."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator
from PIL import Image

from sumo_hmdp.report.case_data import CaseRun
from sumo_hmdp.report.case_road import RoadView, draw_road, draw_vehicles, label_of, look_of, named, style, told
from sumo_hmdp.report.case_snapshots import draw_strips

# Size [in] and resolution [1/in].
SIZE, DPI = (7.6, 4.5), 100
# Marks are so far apart that none comes near the place of the one before it from frame to frame.
VIEW = RoadView(0.0, -125.0, 195.0, 4.0, labels=7.0, mark=14.0, mark_period=45.0)
# Left end, lower end, width and height, as shares of the figure.
UPPER, LOWER, SPEEDS = (0.065, 0.72, 0.925, 0.22), (0.065, 0.42, 0.925, 0.22), (0.065, 0.09, 0.925, 0.18)
COLOR_COUNT = 64


def animation_times(run: CaseRun, every: int) -> tuple[float, ...]:
    """Return the time of every so manieth instant of a run [s]."""
    return tuple(float(time) for time in run.ego.times[::every])


def write_animation(
    path: Path, proposed: CaseRun, rule_based: CaseRun, times: Sequence[float], frame_ms: int, hold_ms: int
) -> None:
    """Write the animation; the same runs give the same bytes.

    Args:
        path: of the GIF; its folder is made if it does not exist.
        proposed: Case 2 under the proposed planner.
        rule_based: Case 2 under the rules.
        times: of the frames [s].
        frame_ms: how long a frame stays [ms].
        hold_ms: how much longer the last one stays [ms].
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    frames = [animation_frame(proposed, rule_based, time) for time in times]
    # One palette for all frames, from one in which everybody is in view; dithering would make still pixels flicker.
    palette = frames[len(frames) // 4].quantize(COLOR_COUNT, dither=Image.Dither.NONE)
    indexed = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [frame_ms] * (len(indexed) - 1) + [frame_ms + hold_ms]
    indexed[0].save(
        path, save_all=True, append_images=indexed[1:], duration=durations, loop=0, optimize=False, disposal=1
    )


def write_still(path: Path, proposed: CaseRun, rule_based: CaseRun, time: float) -> None:
    """Write one frame of the animation as a PNG."""
    path.parent.mkdir(parents=True, exist_ok=True)
    animation_frame(proposed, rule_based, time).save(path, optimize=True)


def animation_frame(proposed: CaseRun, rule_based: CaseRun, time: float) -> Image.Image:
    """Draw one instant: the road under each planner around its ego, and the speeds so far below."""
    with style():
        figure = Figure(figsize=SIZE, dpi=DPI)
        canvas = FigureCanvasAgg(figure)
        for run, place, name in ((proposed, UPPER, "proposed"), (rule_based, LOWER, "rule-based")):
            axes = figure.add_axes(place)
            _road(axes, run, name, time)
            if run is proposed:
                axes.set_xticklabels([])
            else:
                axes.set_xlabel("front bumpers ahead of the ego's [m]", fontsize=8, labelpad=1)
        _speeds(figure.add_axes(SPEEDS), proposed, rule_based, time)
        # matplotlib leaves these two without types.
        canvas.draw()  # type: ignore[no-untyped-call]
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        return Image.fromarray(pixels).convert("RGB")


def _road(axes: Axes, run: CaseRun, name: str, time: float) -> None:
    ego = run.ego
    view = replace(VIEW, zero=float(ego.x[ego.index(time)]))
    draw_road(axes, run, view)
    draw_strips(axes, run, view, time)
    draw_vehicles(axes, run, view, time)
    other = next(named(run))
    at = other.index(time)
    axes.set_title(f"{name} planner, {told(run, time)}", loc="left", fontsize=9)
    pedal = "brakes" if other.accel[at] < -0.05 else "accelerates" if other.accel[at] > 0.05 else ""
    words = f"{label_of(other.vehicle_id)} {pedal} {other.speed[at]:.1f} m/s".replace("  ", " ")
    axes.set_title(words, loc="right", fontsize=9, color=look_of(run, other.vehicle_id).color)
    axes.set_ylabel("lane", fontsize=8, labelpad=1)
    axes.tick_params(labelsize=8)


def _speeds(axes: Axes, proposed: CaseRun, rule_based: CaseRun, time: float) -> None:
    for run, line in ((proposed, "-"), (rule_based, (0, (3.5, 1.4)))):
        for motion in (next(named(run)), run.ego):
            until = motion.index(time) + 1
            color = look_of(run, motion.vehicle_id).color
            label = f"{label_of(motion.vehicle_id)}, {'proposed' if run is proposed else 'rule-based'}"
            axes.plot(
                motion.times[:until], motion.speed[:until], color=color, linestyle=line, linewidth=1.4, label=label
            )
            axes.plot(motion.times[until - 1], motion.speed[until - 1], marker="o", markersize=3.5, color=color)
    axes.set_xlim(0.0, float(proposed.ego.times[-1]))
    axes.set_ylim(23.0, 41.0)
    axes.yaxis.set_major_locator(MultipleLocator(5))
    axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
    axes.set_ylabel("speed [m/s]", fontsize=8, labelpad=2)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(color="0.92", linewidth=0.6)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 0.97), borderaxespad=0, ncols=4, fontsize=8, handlelength=2.4)
