"""Every script of benchmarks and experiments runs, in small, so that none rots unseen. Figures are not judged here."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import pytest

import brick_verdicts
import growth
from takeapart.formats.documents import readable_json, write_atomically

ROOT = Path(__file__).parents[1]
EXPERIMENTS = ROOT / "src" / "takeapart" / "experiments"
BENCHMARKS = ROOT / "benchmarks"

# Of each script what makes it small, and the document, if any, that it fills in.
SMALL: dict[str, tuple[str, str]] = {
    "animation": ("--frames 2", "benchmarks.md --document"),
    "arm_speed": ("--workcells panda ur5e --assemblies 1 --queries 2", ""),
    "brick_verdicts": ("--models external_weight_good", "benchmarks.md --document"),
    "cases_table": ("--cases {drawn} --unit mm --quick --out {folder}/cases", "products.md --document"),
    "clearance_cost": ("--assemblies single/01 --processes 1", "verification.md --document"),
    "closing": ("--count 1", "benchmarks.md --document"),
    "contact_fields": ("", ""),
    "growth": ("--seconds 2 --parts 21 --out {folder}/growth", "benchmarks.md --document"),
    "guide_speed": ("--episodes 1 --repeats 3", "guide.md --document"),
    "path_quality": ("--assemblies single/01 --each 1 --seconds 1 --processes 1", "benchmarks.md --document"),
    "peers": ("--count 1 --seconds 0.01 --sources single/01", "benchmarks.md --document"),
    "pictures": ("--folder {folder}", ""),
    "query_profile": ("--assemblies single/01 --each 4", "benchmarks.md --document"),
    "redundancy": ("--assemblies 1 --grasps 10 --solutions 20", ""),
    "robots": ("panda", ""),
    "shipped_products": (
        "--workcells ur5e --assemblies single/03 --queries 30 --out {folder}/products",
        "benchmarks.md --document",
    ),
    "speed": ("--count 1", "benchmarks.md --write"),
    "startup": ("--repeats 1", "benchmarks.md --document"),
    "statics_time": ("--count 1", "benchmarks.md --document"),
    "teachers": ("{vanilla} --sets single --count 2 --folds 2 --steps 20", "guide.md --document"),
    "time_limit": ("--seconds 0.5 --blocks 4 --sources single/01", "benchmarks.md --document"),
    "verify_all": (
        "--assemblies single/01 --random-seeds 1 --searches random greedy --processes 1 --out {folder}/verified",
        "verification.md --document",
    ),
}


def scripts() -> dict[str, Path]:
    """Files that can be run, by their name."""
    files = [*EXPERIMENTS.glob("*.py"), *BENCHMARKS.glob("*.py")]
    return {file.stem: file for file in files if '__name__ == "__main__"' in file.read_text(encoding="utf-8")}


def test_no_script_is_forgotten() -> None:
    assert sorted(scripts()) == sorted(SMALL)


def run(command: list[str]) -> str:
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return done.stdout


@pytest.fixture(scope="module")
def vanilla(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Experience of tree search on two assemblies."""
    folder = tmp_path_factory.mktemp("vanilla")
    for number in ("01", "02"):
        search = ["--search", "mcts", "--episodes", "1", "--experience", str(folder / f"single-{number}")]
        product = str(ROOT / "data" / "single" / f"{number}.json")
        run([sys.executable, "-m", "takeapart", "plan", product, *search, "--out", str(folder / f"{number}.plan.json")])
    return folder


@pytest.fixture
def drawn(tmp_path: Path) -> Path:
    """A folder with one product: a block on a plate, drawn in mm, before the arm of the workcell."""
    trimesh = pytest.importorskip("trimesh")
    folder = tmp_path / "drawn" / "block"
    folder.mkdir(parents=True)
    for name, size, height in (("plate", (120, 120, 20), 10), ("block", (40, 60, 40), 40)):
        body = trimesh.creation.box(size)
        body.apply_translation((100, 200, height))
        body.export(folder / f"{name}.obj")
    return folder.parent


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SMALL))
def test_script_runs_in_small(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    options, document = SMALL[name]
    if name in ("teachers", "guide_speed"):
        pytest.importorskip("torch", reason="the scripts of the guide need the extra takeapart[guide]")
    if name == "brick_verdicts" and not brick_verdicts.CASES.is_dir():
        pytest.skip(f"the models of bricks are not at {brick_verdicts.CASES}")
    if name in ("verify_all", "clearance_cost"):
        pytest.importorskip("mujoco", reason="verification needs MuJoCo")
    places = {"folder": str(tmp_path), "vanilla": "", "drawn": ""}
    if "{drawn}" in options:
        pytest.importorskip("manifold3d", reason="judging meshes needs the extra takeapart[verify]")
        places["drawn"] = str(request.getfixturevalue("drawn"))
    if "{vanilla}" in options:
        places["vanilla"] = str(request.getfixturevalue("vanilla"))
    file = scripts()[name]
    target = [str(file)] if file.parent == BENCHMARKS else ["-m", f"takeapart.experiments.{name}"]
    command = [sys.executable, *target, *options.format(**places).split()]
    filled = None
    if document:
        source, option = document.split()
        filled = tmp_path / source
        before = re.sub(r"\d", "0", (ROOT / "docs" / source).read_text(encoding="utf-8"))
        filled.write_text(before, encoding="utf-8")
        command += [option, str(filled)]
    printed = run(command)
    if filled is not None:
        assert filled.read_text(encoding="utf-8") != before, "the table in the document is the old one"
    assert printed.strip() or any(tmp_path.iterdir())


@pytest.mark.slow
def test_growth_without_a_plan_in_time(tmp_path: Path) -> None:
    case = growth.CASES[0]
    outcome = growth.run(case, 0.01, 0)
    assert outcome.length is None and outcome.first_plan is None
    file = tmp_path / "outcome.json"
    write_atomically(file, readable_json(asdict(outcome)))
    assert growth.load(file) == outcome
    assert f"| {case.name} |" in growth.table([outcome]) and growth.NOT_FOUND in growth.table([outcome])
