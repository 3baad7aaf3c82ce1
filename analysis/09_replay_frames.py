"""How long the replay page computes for a frame, in headless Chromium, while it plays.

The time is that of the page's own script in each animation frame, without the browser's painting. Without a page the
script runs `highway` with a sight of 1300 m (some 110 vehicles at every instant for 60 s) and takes its page.
Absolute times depend on the machine: give two pages to compare them on one.

    python analysis/09_replay_frames.py [PAGE.html ...] [--seconds 15] [--rate 1]
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

# Times every callback of an animation frame.
TIMED = """
window.frameTimes = [];
const asked = window.requestAnimationFrame.bind(window);
window.requestAnimationFrame = (callback) => asked((now) => {
  const start = performance.now();
  callback(now);
  window.frameTimes.push(performance.now() - start);
});
"""


def crowded_page(folder: Path) -> Path:
    """Run the highway with everybody in sight and return its page."""
    options = RunOptions(None, "search", 0, None, overrides={"traffic.sight_m": 1300.0})
    record = execute(load_scenario(find_scenario("highway"), options))
    return write_replay(folder / "crowded.html", record.manifest, record.steps, record.decisions)


def frame_times(chromium: Any, page_path: Path, seconds: float, rate: float) -> np.ndarray:  # noqa: ANN401 - Playwright's
    """Play a page and return the script's time in every frame [ms]."""
    page = chromium.new_page(viewport={"width": 1280, "height": 900})
    page.add_init_script(TIMED)
    page.goto(page_path.resolve().as_uri())
    page.evaluate("window.replayReady")
    page.select_option("#rate", f"{rate:g}")
    page.evaluate("window.frameTimes.length = 0")
    page.click("#play")
    page.wait_for_timeout(1000 * seconds)
    times = np.asarray(page.evaluate("window.frameTimes"))
    page.close()
    return times


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pages", nargs="*", type=Path)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--rate", type=float, default=1.0)
    arguments = parser.parse_args()
    executable = shutil.which("chromium") or shutil.which("google-chrome")
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        pages = arguments.pages or [crowded_page(Path(folder))]
        chromium = playwright.chromium.launch(executable_path=executable, args=["--no-sandbox", "--disable-gpu"])
        print("page size [MB]  frames/s  script per frame [ms]: median   95 %   99 %  worst")
        for page in pages:
            times = frame_times(chromium, page, arguments.seconds, arguments.rate)
            quantiles = "  ".join(f"{np.quantile(times, q):5.1f}" for q in (0.5, 0.95, 0.99, 1.0))
            size = page.stat().st_size / 1e6
            print(f"{size:14.2f}  {len(times) / arguments.seconds:8.1f}  {'':22}{quantiles}  {page.name}")
        chromium.close()


if __name__ == "__main__":
    main()
