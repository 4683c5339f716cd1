"""The products that are shipped: they load, fit together as solids, and are what the generator draws."""

from __future__ import annotations

import json
from pathlib import Path

import manifold3d
import numpy as np
import pytest
from click.testing import CliRunner

from takeapart.cli.commands import main
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.generate.products import PRODUCTS
from takeapart.model.assembly import Part
from takeapart.model.meshes import Mesh
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.stability.contacts import ContactStability
from takeapart.verification import verify_plan

NAMES = sorted(PRODUCTS)
SHIPPED = data_path("products")
QUICK_FIRST = ["pump", *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES if name != "pump")]
DEEPEST = 5e-5  # m that parts of a shipped product may overlap


def solid(part: Part) -> manifold3d.Manifold:
    surface = part.shape.surface().moved(part.T_world_part)
    return manifold3d.Manifold(
        manifold3d.Mesh64(np.ascontiguousarray(surface.vertices), surface.triangles.astype(np.uint64))
    )


def contents(folder: Path) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_all_products_are_shipped_and_no_others() -> None:
    assert sorted(folder.name for folder in SHIPPED.iterdir()) == NAMES
    assert sum(len(content) for content in contents(SHIPPED).values()) < 5e6


@pytest.mark.parametrize("name", NAMES)
def test_the_generator_draws_what_is_shipped(name: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["generate", "products", name, "--out", str(tmp_path), "--json"])
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["files"][0]["name"] == name
    assert contents(tmp_path / name) == contents(SHIPPED / name)


@pytest.mark.parametrize("name", NAMES)
def test_parts_are_closed_and_do_not_overlap(name: str) -> None:
    assembly = load_assembly(SHIPPED / name / "assembly.json")
    assert 8 <= len(assembly.parts) <= 60
    assert all(isinstance(part.shape, Mesh) and part.shape.is_closed for part in assembly.parts)
    solids = [solid(part) for part in assembly.parts]
    assert all(each.status() == manifold3d.Error.NoError and each.volume() > 0 for each in solids)
    for a, first in enumerate(solids):
        for b, second in enumerate(solids[:a]):
            common = first ^ second
            if common.volume() > 1e-15:  # twice the volume over the surface is the thickness of a thin layer
                deep = 2 * common.volume() / common.surface_area()
                assert deep < DEEPEST, (assembly.parts[a].name, assembly.parts[b].name)


@pytest.mark.parametrize("name", QUICK_FIRST)
def test_every_product_stands_as_drawn(name: str) -> None:
    assert ContactStability(load_assembly(SHIPPED / name / "assembly.json")).floating() == ()


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_plan_of_it_holds(name: str) -> None:
    assembly = load_assembly(SHIPPED / name / "assembly.json")
    workcell = load_workcell(str(assembly.provenance["workcell"]))
    made = plan(assembly, workcell, PlanningOptions(search="exact"))
    assert isinstance(made, Plan), str(made)
    assert len(made.steps) == sum(not part.fixed for part in assembly.parts)
    report = verify_plan(made, assembly, workcell)
    assert report.passed, report.findings


def test_an_unknown_product_is_named_with_those_that_there_are(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["generate", "products", "bridge", "--out", str(tmp_path / "new")])
    assert result.exit_code == 2
    assert "unknown product 'bridge'; valid: " in result.stderr and "gearbox" in result.stderr
    assert not (tmp_path / "new").exists()
