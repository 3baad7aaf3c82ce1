"""docs/tutorial.md as a newcomer reads it: every file is written, every command and snippet is executed, in order."""

import os
import re
import subprocess
import sys
from pathlib import Path

import sumo_hmdp

TUTORIAL = (Path(__file__).parents[2] / "docs" / "tutorial.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)([^\n]*)\n(.*?)^```$", TUTORIAL, re.MULTILINE | re.DOTALL)
# Shorter runs and fewer of them, and an installation that leaves this environment alone: all else is as it stands.
INSTEAD = {
    "seeds: {first: 0, count: 12}": "seeds: {first: 0, count: 2}",
    "duration_s: [30.0]": "duration_s: [2.0]",
    "--editable": "--quiet --target site",
}


def test_every_block_of_the_tutorial_works(command, tmp_path):
    for old in INSTEAD:
        assert TUTORIAL.count(old) == 1
    folders = [str(tmp_path / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {
        **os.environ,
        "PATH": os.pathsep.join([str(Path(command).parent), os.environ["PATH"]]),
        "PYTHONPATH": os.pathsep.join(folders),
        "PIP_NO_INDEX": "1",
    }
    done = []
    for language, note, text in BLOCKS:
        for old, new in INSTEAD.items():
            text = text.replace(old, new)  # noqa: PLW2901
        if language == "yaml":
            file = tmp_path / re.fullmatch(r" title=(\S+)", note)[1]
            file.write_text(text, encoding="utf-8")
        elif language in {"sh", "python"}:
            # -P keeps the folder off the path, as everywhere in these tests.
            shell = ["bash", "-e"] if language == "sh" else [sys.executable, "-P", "-W", "error", "-"]
            ran = subprocess.run(
                shell, input=text, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
                timeout=300,
            )  # fmt: skip
            assert ran.returncode == 0, f"{text}\n{ran.stdout}\n{ran.stderr}"
        else:
            # `text` is what something printed, `console` sets up what these tests have already.
            assert language in {"text", "console"}
        done.append(language)
    assert (done.count("sh") >= 4, done.count("python") >= 3, done.count("yaml")) == (True, True, 1)
    runs = sumo_hmdp.load(tmp_path / "results" / "mine").runs
    assert runs.groupby("planner").size().to_dict() == {"hmdp_mpc": 4, "idm_mobil": 4, "my_planner": 4}
    assert set(runs["status"]) == {"completed"}
