"""Pages of docs/ as a newcomer reads them: every file is written, every command and snippet is executed, in order."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import sumo_hmdp

DOCS = Path(__file__).parents[2] / "docs"
# Shorter runs and fewer of them, and an installation that leaves this environment alone: all else is as it stands.
INSTEAD = {
    "tutorial.md": {
        "seeds: {first: 0, count: 12}": "seeds: {first: 0, count: 2}",
        "duration_s: [30.0]": "duration_s: [2.0]",
        "--editable": "--quiet --target site",
    },
    "howto/scenario.md": {"duration_s: 24.0": "duration_s: 2.4"},
    "howto/planner.md": {},
    "howto/notebook.md": {},
    "api/scenarios.md": {'"duration_s": 5.0': '"duration_s": 0.6'},
}


@pytest.fixture
def follow(command, tmp_path):
    """Do what a page says; return how many blocks of each language it has."""

    def follow_page(name):
        page = (DOCS / name).read_text(encoding="utf-8")
        folders = [str(tmp_path / "site"), *filter(None, [os.environ.get("PYTHONPATH")])]
        environment = {
            **os.environ,
            "PATH": os.pathsep.join([str(Path(command).parent), os.environ["PATH"]]),
            "PYTHONPATH": os.pathsep.join(folders),
            "PIP_NO_INDEX": "1",
        }
        for old, new in INSTEAD[name].items():
            assert page.count(old) == 1
            page = page.replace(old, new)
        done = []
        for language, note, text in re.findall(r"^```(\w+)([^\n]*)\n(.*?)^```$", page, re.MULTILINE | re.DOTALL):
            if language == "yaml":
                (tmp_path / re.fullmatch(r" title=(\S+)", note)[1]).write_text(text, encoding="utf-8")
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
        return {language: done.count(language) for language in done}

    return follow_page


def test_every_block_of_the_tutorial_works(follow, tmp_path):
    blocks = follow("tutorial.md")
    assert (blocks["sh"] >= 4, blocks["python"] >= 3, blocks["yaml"]) == (True, True, 1)
    runs = sumo_hmdp.load(tmp_path / "results" / "mine").runs
    assert runs.groupby("planner").size().to_dict() == {"hmdp_mpc": 4, "idm_mobil": 4, "my_planner": 4}
    assert set(runs["status"]) == {"completed"}


def test_every_block_on_scenarios_works(follow, tmp_path):
    assert follow("howto/scenario.md") == {"yaml": 3, "sh": 3, "python": 1}
    assert len(sumo_hmdp.load(tmp_path / "results").runs) == 2
    assert len(sumo_hmdp.load(tmp_path / "results" / "variants").runs) == 4


@pytest.mark.parametrize(
    ("name", "snippets"), [("howto/planner.md", 5), ("api/scenarios.md", 1), ("howto/notebook.md", 2)]
)
def test_every_snippet_works(follow, name, snippets):
    assert follow(name)["python"] == snippets
