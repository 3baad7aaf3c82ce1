"""A hundred stores that are damaged by chance: read or a file named, and made whole again by going on.

The full version, a thousand in processes of their own, is analysis/14_damaged_stores.py.
"""

import faulthandler
import importlib.util
import shutil
import sys
from pathlib import Path

import pytest

from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.worker import run_job


@pytest.fixture(scope="module")
def analysis():
    file = Path(__file__).parents[3] / "analysis" / "14_damaged_stores.py"
    spec = importlib.util.spec_from_file_location("damaged_stores", file)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def sound(analysis, tmp_path_factory):
    """A sound store, and its runs by name: what is done again is the same."""
    folder = tmp_path_factory.mktemp("sound")
    file = folder / "study.yaml"
    file.write_text(analysis.STUDY.replace("[0.6, 0.9]", "[0.3, 0.6]"))
    design, known = load_design(file), {}

    def do(job):
        if job.run_id not in known:
            known[job.run_id] = run_job(job)
        return known[job.run_id]

    return design, file, folder / "out", analysis.sound_store(design, file, folder / "out", do), do


@pytest.mark.parametrize("first", range(0, 100, 25))
def test_no_damage_ends_in_a_traceback(analysis, sound, tmp_path, first):
    design, file, store, expected, do = sound
    # A reader that hangs ends the tests and says where.
    faulthandler.dump_traceback_later(300, exit=True)
    for seed in range(first, first + 25):
        folder = tmp_path / str(seed)
        shutil.copytree(store, folder)
        done = analysis.damage(folder, seed)
        try:
            analysis.trial(design, file, folder, expected, do)
        except BaseException as error:
            raise AssertionError(f"seed {seed}: {done}") from error
        shutil.rmtree(folder)
    faulthandler.cancel_dump_traceback_later()
