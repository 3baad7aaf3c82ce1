"""The file of a film: what may be asked for, and writing its frames as GIF (Pillow) or MP4 (PyAV)."""

import importlib.util
import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain
from pathlib import Path

import numpy as np
from PIL import Image

from sumo_hmdp.errors import InputError
from sumo_hmdp.study.store import whole

# Defaults by kind: frames a second and width [px]; a GIF is larger for each.
DEFAULTS = {".mp4": (25.0, 1280), ".gif": (10.0, 800)}
FPS_MAX = {".mp4": 60.0, ".gif": 50.0}
WIDTHS = (320, 3840)
COLOR_COUNT = 128
# Quality of H.264 from 0 (perfect) to 51; 20 keeps thin lines clean.
CRF = "20"


@dataclass(frozen=True)
class FilmFormat:
    """How a film is made.

    Attributes:
        kind: `.mp4` or `.gif`.
        speed: seconds of the run in a second of the film.
        fps: frames a second; of a GIF one whose frames last whole hundredths of a second.
        width: of a frame, even [px].
    """

    kind: str
    speed: float
    fps: float
    width: int


def film_format(path: Path, speed: float = 1.0, fps: float | None = None, width: int | None = None) -> FilmFormat:
    """Check what is asked for.

    Args:
        path: of the film.
        speed: seconds of the run in a second of the film.
        fps: frames a second; None takes the kind's own.
        width: [px]; None takes the kind's own.

    Raises:
        InputError: with every mistake; also if the kind needs a package that is not there.
    """
    kind = path.suffix.lower()
    if kind not in DEFAULTS:
        raise InputError([f"the film must end in .mp4 or .gif, got {str(path)!r}. Name one of these"])
    problems = []
    asked_fps = DEFAULTS[kind][0] if fps is None else fps
    asked_width = DEFAULTS[kind][1] if width is None else width
    if not (math.isfinite(speed) and 0.05 <= speed <= 100):
        problems.append(f"--speed: must be between 0.05 and 100, got {speed:g}. Choose such as 2")
    if not 1 <= asked_fps <= FPS_MAX[kind]:
        problems.append(
            f"--fps: must be between 1 and {FPS_MAX[kind]:g} in {kind}, got {asked_fps:g}. Choose such as 25"
        )
    if not WIDTHS[0] <= asked_width <= WIDTHS[1]:
        problems.append(
            f"--width: must be between {WIDTHS[0]} and {WIDTHS[1]} px, got {asked_width}. Choose such as 1280"
        )
    if kind == ".mp4" and importlib.util.find_spec("av") is None:
        problems.append(".mp4 needs PyAV, which is not installed; `pip install 'sumo-hmdp[video]'`, or name a .gif")
    if problems:
        raise InputError(problems)
    if kind == ".gif":
        # A GIF counts its frames' time in hundredths of a second.
        asked_fps = 100 / max(round(100 / asked_fps), 2)
    return FilmFormat(kind, speed, asked_fps, asked_width - asked_width % 2)


def write_frames(path: Path, frames: Iterator[Image.Image], made: FilmFormat) -> None:
    """Write a film whole or not at all.

    Args:
        path: of the film; its folder is made if it does not exist.
        frames: at least one, all of one even size.
        made: how.

    Raises:
        InputError: if the file cannot be written.
    """
    try:
        with whole(path) as partial:
            (_write_gif if made.kind == ".gif" else _write_mp4)(partial, frames, made)
    except OSError as error:
        raise InputError([f"{path} cannot be written: {error.strerror or error}. Choose another"]) from None


def _write_gif(path: Path, frames: Iterator[Image.Image], made: FilmFormat) -> None:
    first = next(frames)
    # One palette for all, without dithering, which would make still pixels flicker.
    palette = first.quantize(COLOR_COUNT, dither=Image.Dither.NONE)
    indexed = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in chain([first], frames))
    next(indexed).save(
        path, format="GIF", save_all=True, append_images=indexed, duration=round(1000 / made.fps), loop=0,
        optimize=False, disposal=1,
    )  # fmt: skip


def _write_mp4(path: Path, frames: Iterator[Image.Image], made: FilmFormat) -> None:
    import av  # noqa: PLC0415 - an optional extra

    with av.open(str(path), "w", format="mp4") as container:
        stream = None
        for frame in frames:
            if stream is None:
                stream = container.add_stream("libx264", rate=Fraction(made.fps).limit_denominator(1000))
                stream.width, stream.height, stream.pix_fmt = frame.width, frame.height, "yuv420p"
                stream.options = {"crf": CRF}
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.asarray(frame), format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
