"""What a run is made with: named, hashed from sources, and told apart."""

import importlib
import os
import sys
from dataclasses import replace
from importlib.metadata import EntryPoint, PathDistribution

import pytest

from sumo_hmdp.decision import plugin_source
from sumo_hmdp.decision.plugin_source import package_of
from sumo_hmdp.errors import InputError
from sumo_hmdp.scenario.load import RunOptions, find_scenario, load_scenario
from sumo_hmdp.study import identity, runner, worker
from sumo_hmdp.study.design import load_design
from sumo_hmdp.study.identity import cell_id_of
from sumo_hmdp.study.machine import source_hash, versions
from sumo_hmdp.study.runner import job_of
from sumo_hmdp.study.versions import differences, mixture, read_versions, write_versions


def test_versions_name_the_machine_and_its_arithmetic():
    found = versions()
    assert found.keys() >= {"sumo_hmdp", "sumo_hmdp_source", "numpy", "cpu", "numpy_dispatch", "blas", "python"}
    assert all(found.values())
    assert len(found["sumo_hmdp_source"]) == 12


def test_the_kernel_is_the_one_that_is_in_use(shell_python):
    """As OpenBLAS and numpy were told by their own variables."""
    program = "from sumo_hmdp.study.machine import versions as v; print(v()['blas'], '|', v()['numpy_dispatch'])"
    usual = shell_python(program)
    if "openblas" not in usual:
        pytest.skip(f"another BLAS: {usual}")
    told = shell_python(program, OPENBLAS_CORETYPE="Prescott", NPY_DISABLE_CPU_FEATURES="X86_V3")
    assert told.split("|")[0] != usual.split("|")[0]
    assert told.split("|")[1] != usual.split("|")[1] or "X86_V3" not in usual


@pytest.fixture
def shell_python():
    import subprocess  # noqa: PLC0415 - here alone

    def run(program, **more):
        done = subprocess.run(
            [sys.executable, "-P", "-W", "ignore", "-c", program], capture_output=True, text=True, check=True,
            env={**os.environ, **more},
        )  # fmt: skip
        return done.stdout.strip()

    return run


def test_sources_are_hashed_by_name_and_content_but_not_what_only_reads(tmp_path):
    (tmp_path / "decision").mkdir()
    (tmp_path / "decision" / "cost.py").write_text("a = 1\n")
    first = source_hash(tmp_path)
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "page.py").write_text("a = 1\n")
    (tmp_path / "cli.py").write_text("a = 1\n")
    assert source_hash(tmp_path) == first
    (tmp_path / "decision" / "cost.py").write_text("a = 2\n")
    assert source_hash(tmp_path) != first


def test_differences_and_mixtures_are_said_in_words(tmp_path):
    one, two = {"sumo": "1", "cpu": "a"}, {"sumo": "1", "cpu": "b", "blas": "c"}
    assert differences(one, two) == ("cpu a, now b", "blas not recorded, now c")
    assert differences(one, one) == ()
    assert mixture([(one, 2), (one, 1)]) == ""
    assert mixture([(one, 2), (two, 1)]) == "cpu a (2 runs), b (1 run); blas c (1 run), not recorded (2 runs)"
    assert read_versions(tmp_path, write_versions(tmp_path, two)) == two
    assert read_versions(tmp_path, "../secret") == read_versions(tmp_path, None) == {}


@pytest.mark.parametrize("planner", ["constant", "hmdp_mpc"])
def test_worlds_that_are_drawn_from_other_models_are_other_cells(tmp_path, planner):
    def design(scenario):
        file = tmp_path / "study.yaml"
        file.write_text(
            f"name: m\nscenarios: [{scenario}]\nseeds: {{count: 1}}\nsolver: search\n"
            f"factors: {{planner: [{planner}], planners.hmdp_mpc.accel_mps2: [1.0, 2.0], duration_s: [3.0]}}\n"
        )
        return load_design(file)

    assert len(design("matched").cells) == 2
    # Where nobody is drawn from it, the model means nothing to who does not plan with it.
    assert len(design("case2").cells) == (1 if planner == "constant" else 2)


@pytest.fixture
def plugin(tmp_path, monkeypatch):
    """Write a package of one planner, installed or worked on in place; its entry point."""
    monkeypatch.syspath_prepend(str(tmp_path))
    names = []

    def write(files, module, listed=()):
        for name, text in files.items():
            (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / name).write_text(text)
        info = tmp_path / "plug-1.0.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: plug\nVersion: 1.0\n")
        if listed:
            (info / "RECORD").write_text("".join(f"{name},,\n" for name in listed))
        importlib.invalidate_caches()
        importlib.import_module(module)
        names.append(module)
        return EntryPoint("p", f"{module}:P", "g")._for(PathDistribution(info))

    yield write
    for name in names:
        for loaded in [one for one in sys.modules if one.split(".")[0] == name.split(".")[0]]:
            del sys.modules[loaded]


ONE = "P = 1\n"


@pytest.mark.parametrize(
    ("files", "module", "listed", "changed", "other"),
    [
        ({"plug_a.py": ONE}, "plug_a", (), "plug_a.py", "readme.py"),
        ({"plug_b/__init__.py": "", "plug_b/x.py": ONE, "plug_b/t.json": "1"}, "plug_b.x", (), "plug_b/t.json", "y.py"),
        ({"plug_c.py": "import plug_d", "plug_d.py": "from plug_e import P", "plug_e.py": ONE},
         "plug_c", (), "plug_e.py", "plug_f.py"),
        ({"plug_g.py": ONE, "plug_h.dat": "1"}, "plug_g", ("plug_g.py", "plug_h.dat"), "plug_h.dat", "plug_i.dat"),
    ],
)  # fmt: skip
def test_a_planner_s_source_is_all_that_it_is_made_of(plugin, tmp_path, files, module, listed, changed, other):
    entry = plugin(files, module, listed)
    before = package_of(entry)
    assert (before.name, before.version) == ("plug", "1.0")
    (tmp_path / other).write_text("another = 1\n")
    assert package_of(entry) == before
    (tmp_path / changed).write_text("z = P = 2\n")
    assert package_of(entry).source != before.source


def test_a_changed_planner_is_another_cell_and_no_worker_of_another_version_drives(monkeypatch, tiny):
    ready = load_scenario(find_scenario("case2"), RunOptions(planner="constant"))
    own = cell_id_of(ready)
    package = plugin_source.PlannerPackage("plug", "1.0", "aaaa")
    names = set()
    for one in (package, replace(package, version="1.1"), replace(package, source="bbbb")):
        monkeypatch.setattr(identity, "planner_package", lambda name, one=one: one)
        names.add(cell_id_of(ready))
    assert len(names | {own}) == 4
    monkeypatch.setattr(runner, "planner_package", lambda name: package)
    job = job_of(tiny, tiny.cells[0], 0)
    monkeypatch.setattr(worker, "planner_package", lambda name: replace(package, source="bbbb"))
    with pytest.raises(InputError, match=r"must be of plug 1.0 \(source aaaa\), got plug 1.0 \(source bbbb\)"):
        job.ready()
