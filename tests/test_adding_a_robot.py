"""The two commands of docs/robots.md, from fresh URDFs to a verified plan."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from takeapart.formats.robot_files import load_robot_description
from takeapart.formats.shipped import data_path

DOCUMENT = Path(__file__).resolve().parents[1] / "docs" / "robots.md"
SHARED = Path(__file__).resolve().parents[2] / "shared" / "robots"


def commands() -> list[list[str]]:
    """Those of the section "Add one in five minutes"."""
    text = DOCUMENT.read_text(encoding="utf-8")
    found = re.search(r"## Add one in five minutes\n\n```sh\n(.*?)```", text, re.DOTALL)
    assert found is not None
    return [shlex.split(line) for line in found[1].replace("\\\n", " ").splitlines() if line]


def run(folder: Path, arm: Path, gripper: Path | None) -> None:
    """The document's commands with other names for the files, and the verification."""
    names = {"arm.urdf": str(arm), "gripper.urdf": str(gripper), "product.json": str(data_path("examples/rack.json"))}
    for words in [*commands(), ["takeapart", "verify", "plan.json"]]:
        named = [names.get(word, word) for word in words]
        if gripper is None and "--gripper" in named:
            k = named.index("--gripper")
            del named[k : k + 2]
        done = subprocess.run(
            [sys.executable, "-m", *named], cwd=folder, capture_output=True, text=True, timeout=1500, check=False
        )
        assert done.returncode == 0, f"{named}: {done.stderr}"
    plan = json.loads((folder / "plan.json").read_text(encoding="utf-8"))
    assert len(plan["steps"]) == 5


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_two_commands_lead_from_a_urdf_to_a_verified_plan(tmp_path: Path) -> None:
    known = load_robot_description("ur5e")
    run(tmp_path, known.arm.files.urdf, known.gripper.files.urdf)


@pytest.mark.slow
@pytest.mark.timeout(3000)
@pytest.mark.skipif(not SHARED.is_dir(), reason="these robots are not part of the project")
@pytest.mark.parametrize("name", ["ur5e", "xarm7", "gen3_2f85", "iiwa7"])
def test_the_same_with_files_of_four_makers(tmp_path: Path, name: str) -> None:
    own = name == "gen3_2f85"
    run(tmp_path, SHARED / f"{name}.urdf", None if own else SHARED / "robotiq_2f_85.urdf")
