"""How long the replay page computes for a frame, in headless Chromium, while it plays.

The time is that of the page's own script in each animation frame at 60 frames a second, without the browser's painting;
of several passes the shortest counts, so that what else the machine does stays out. Without a page the script runs
`highway` with a sight of 1300 m (some 110 vehicles at every instant for 60 s) and takes its page. Absolute times depend
on the machine: give two pages to compare them on one.

    python analysis/09_replay_frames.py [PAGE.html ...] [--seconds 60] [--passes 3]
"""

import argparse
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from sumo_hmdp.report.replay import write_replay
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study.run import execute

# The page's clock stands; every frame moves it by a sixtieth of a second, and is timed by the real one.
STEPPED = """
const real = performance.now.bind(performance);
let [clock, queue] = [0, []];
performance.now = () => clock;
window.requestAnimationFrame = (callback) => queue.push(callback);
window.playFrames = (count) => Array.from({ length: count }, () => {
  clock += 1000 / 60;
  const due = queue;
  queue = [];
  const start = real();
  due.forEach((callback) => callback(clock));
  return real() - start;
});
"""
# Frames between two moments in which the browser may paint.
CHUNK = 60


def crowded_page(folder: Path) -> Path:
    """Run the highway with everybody in sight and return its page."""
    options = RunOptions(None, "search", 0, None, overrides={"traffic.sight_m": 1300.0})
    record = execute(load_scenario(find_scenario("highway"), options))
    return write_replay(folder / "crowded.html", record.manifest, record.steps, record.decisions)


def frame_times(chromium: Any, page_path: Path, seconds: float, passes: int) -> np.ndarray:  # noqa: ANN401 - Playwright's
    """Play the first seconds of a page several times; return each frame's shortest time in the script [ms]."""
    page = chromium.new_page(viewport={"width": 1280, "height": 900})
    page.add_init_script(STEPPED)
    page.goto(page_path.resolve().as_uri())
    page.evaluate("window.replayReady")
    played = []
    for _ in range(passes):
        page.keyboard.press("Home")
        page.keyboard.press("Space")
        chunks = [page.evaluate(f"window.playFrames({CHUNK})") for _ in range(round(60 * seconds / CHUNK))]
        played.append(np.concatenate(chunks))
        page.keyboard.press("Space")
        page.evaluate("window.playFrames(2)")
    page.close()
    return np.min(played, axis=0)


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--passes", type=int, default=3)
    arguments = parser.parse_args()
    executable = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        pages = arguments.pages or [crowded_page(Path(folder))]
        chromium = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox", "--disable-gpu"])
        print("page size [MB]  frames  script per frame [ms]: median   95 %   99 %  worst  above 8 ms")
        for page in pages:
            times = frame_times(chromium, page, arguments.seconds, arguments.passes)
            quantiles = "  ".join(f"{np.quantile(times, q):5.1f}" for q in (0.5, 0.95, 0.99, 1.0))
            share = f"{100 * np.mean(times > 8):8.2f} %"
            print(f"{page.stat().st_size / 1e6:14.2f}  {len(times):6}  {'':22}{quantiles}  {share}  {page.name}")
        chromium.close()


if __name__ == "__main__":
    main()
