"""One product drawn in several ways gives one plan: in other units, of other triangles, turned about the vertical."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from manifold3d import Manifold, Mesh64

from mesh_cases import folder
from takeapart.formats.files import load_workcell
from takeapart.formats.importing import import_product
from takeapart.model.assembly import Assembly, Joint
from takeapart.model.geometry import Array
from takeapart.planning import PlanningOptions, search
from takeapart.problem import AssemblyProblem
from takeapart.removal.planner import RemovalPlanner
from takeapart.search.result import SearchResult
from takeapart.stability import require_standing
from takeapart.workcell import Workcell

PRODUCT = "fabrica_plumbers_block"
SEEDS = 5
SCALES = {"mm": 1e3, "cm": 1e2, "inch": 1 / 0.0254}


def drawn(name: str, target: Path, change: Callable[[trimesh.Trimesh], trimesh.Trimesh]) -> Path:
    """A copy of a product in which every mesh is changed."""
    target.mkdir(parents=True)
    for file in sorted(folder(name).glob("*.obj")):
        mesh = trimesh.load_mesh(str(file), process=False)
        merged = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        merged.merge_vertices(merge_tex=True, merge_norm=True)
        change(merged).export(target / file.name, digits=12)
    return target


def planned(assembly: Assembly, workcell: Workcell, seeds: int = 1) -> list[SearchResult]:
    """Exact search to its proof, once for every seed; what does not depend on it is worked out once."""
    planner, options, found = RemovalPlanner(assembly, workcell), PlanningOptions(), []
    stability = require_standing(assembly)
    for seed in range(seeds):
        planner.forget_grasps()
        problem = AssemblyProblem(planner, stability, seed)
        found.append(search(problem, replace(options, seed=seed)))
    return found


def order(result: SearchResult) -> list[int]:
    return [removal.part for removal in result.removals]


def length(result: SearchResult) -> float:
    return sum(removal.length for removal in result.removals)


def scaled(by: float, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices * by, mesh.faces, process=False)


def turned(by: float, around: Array, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return mesh.apply_transform(trimesh.transformations.rotation_matrix(by, [0, 0, 1], around))


def held_by_glue(assembly: Assembly) -> Assembly:
    """Both top frames of the aeroplane hang on their landing gears, as they do by screws that nobody drew."""
    joints = []
    for part in assembly.parts:
        if not part.fixed:
            low, high = part.shape.surface().moved(part.T_world_part).bounds
            corners = np.array(
                [[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
            )
            host = part.name.replace("TopLeft", "LandingGear")
            joints.append(
                Joint(f"glue-{part.name}", "glue", host, part.name, corners, np.array([0.0, 0.0, -1.0]), 50.0)
            )
    return replace(assembly, joints=tuple(joints))


def remeshed(by: int, mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The same body of other triangles: 0 as drawn, 1 and 2 divided into 4 and into no edge above 8 mm, 3 and 4 with
    fewer, moved by at most 0.01 and 0.03 mm."""
    if by == 1:
        return mesh.subdivide()
    if by == 2:
        vertices, faces = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, 0.008)
        return trimesh.Trimesh(vertices, faces, process=False)
    solid = Manifold(Mesh64(np.asarray(mesh.vertices), np.asarray(mesh.faces, dtype=np.uint64)))
    found = solid.simplify((0.0, 0.0, 0.0, 1e-5, 3e-5)[by]).to_mesh64()
    return trimesh.Trimesh(np.asarray(found.vert_properties)[:, :3], np.asarray(found.tri_verts), process=False)


def settled_order(result: SearchResult) -> list[int]:
    """The order, where of two that follow each other the lower number comes first if neither motion meets the other
    part: both orders have the same motions and the same length, so which one a search gives is a tie."""
    removals = list(result.removals)
    for _ in removals:
        for k in range(len(removals) - 1):
            first, second = removals[k : k + 2]
            if second.part < first.part and not second.blockers >> first.part & 1:
                removals[k : k + 2] = [second, first]
    return [removal.part for removal in removals]


def about_the_same(results: list[SearchResult], noise: float) -> bool:
    """Whether all take the same order but for ties, and none is longer or shorter than the median by more than a
    share."""
    lengths = [length(result) for result in results]
    print([f"{value:.4f}" for value in lengths], order(results[0]))
    middle = float(np.median(lengths))
    return (
        len({tuple(settled_order(result)) for result in results}) == 1
        and max(abs(v / middle - 1) for v in lengths) <= noise
    )


def assert_same(first: Assembly, other: Assembly) -> None:
    for part, copy in zip(first.parts, other.parts, strict=True):
        assert part.shape.hash == copy.shape.hash  # type: ignore[attr-defined]
        assert np.array_equal(part.T_world_part, copy.T_world_part)
        assert part.mass == pytest.approx(copy.mass, rel=1e-9)


def test_copies_in_other_units_are_the_same_product(tmp_path: Path) -> None:
    """The same shapes, masses and places: plans follow from them."""
    name = "furniture_drawer"
    first = import_product(folder(name), "m").assembly
    for unit, scale in SCALES.items():
        copy = drawn(name, tmp_path / unit, functools.partial(scaled, scale))
        assert_same(first, import_product(copy, unit).assembly)


@pytest.mark.parametrize("seed", range(5))
def test_numbers_to_a_nanometre_are_read_alike_in_every_unit(tmp_path: Path, seed: int) -> None:
    """As programs write them, six digits after the point in mm: the middle of every other body lies between two of
    them."""
    body = trimesh.creation.icosphere(2, 20.0)
    noise = np.random.default_rng(seed).uniform(-1, 1, body.vertices.shape)
    body.vertices = np.round(body.vertices + noise, 6)
    products = []
    for unit, scale in SCALES.items():
        (tmp_path / unit).mkdir()
        for k in range(2):
            copy = trimesh.Trimesh((body.vertices + [0.0, 0.0, 50.0 * k]) * (scale / 1e3), body.faces, process=False)
            copy.export(tmp_path / unit / f"body{k}.obj", digits=12)
        products.append(import_product(tmp_path / unit, unit).assembly)
    for other in products[1:]:
        assert_same(products[0], other)
    assert products[0].parts[0].shape is products[0].parts[1].shape, "a shape that is there twice"


@pytest.mark.slow
def test_copies_in_other_units_have_the_same_plan(tmp_path: Path) -> None:
    results = []
    for unit, scale in SCALES.items():
        copy = drawn(PRODUCT, tmp_path / unit, functools.partial(scaled, scale))
        results += planned(import_product(copy, unit).assembly, load_workcell("panda"))
    first, *others = results
    assert order(first)
    for other in others:
        assert order(other) == order(first)
        for mine, theirs in zip(first.removals, other.removals, strict=True):
            assert mine.length == pytest.approx(theirs.length, abs=1e-6)
            assert np.allclose(mine.joint_path, theirs.joint_path, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_five_tessellations_of_a_step_file() -> None:
    """Two parts of it that an arm can take, for the rest has screws that nobody drew. Two seeds each tell the noise:
    lengths of one tessellation differ by up to 4 %."""
    results = []
    for deflection in (2e-5, 5e-5, 1e-4, 2e-4, 5e-4):
        fixed, overlaps = ["*Gear", "*Cap", "*Plate", "*BottomLeft"], (("AeroFrame_Plate", "AeroFrame_Cap"),)
        file = folder("step_aero") / "AeroAssembly.step"
        product = import_product(file, fix=fixed, allow_overlap=overlaps, deflection=deflection)
        results += planned(held_by_glue(product.assembly), load_workcell("panda-table"), seeds=2)
    assert len(order(results[0])) == 2
    assert about_the_same(results, noise=0.04)


@pytest.mark.slow
def test_five_triangulations_of_one_product(tmp_path: Path) -> None:
    results = []
    for by in range(5):
        copy = drawn(PRODUCT, tmp_path / str(by), functools.partial(remeshed, by))
        results += planned(import_product(copy, "m").assembly, load_workcell("panda"))
    assert len(order(results[0])) == 4
    assert about_the_same(results, noise=0.02)


@pytest.mark.slow
def test_a_product_turned_by_37_degrees(tmp_path: Path) -> None:
    """About the vertical through its middle. The arm has another scene then, so lengths agree no better than those of
    two products that are alike; five seeds find the same length in each."""
    middle = np.zeros(3)  # as drawn
    copy = drawn(PRODUCT, tmp_path / "turned", functools.partial(turned, np.radians(37), middle))
    cell, results = load_workcell("panda"), []
    for source in (folder(PRODUCT), copy):
        results += planned(import_product(source, "m").assembly, cell, SEEDS)
    assert len(order(results[0])) == 4
    assert about_the_same(results, noise=0.02)


@pytest.mark.slow
def test_product_and_cell_turned_together_by_37_degrees(tmp_path: Path) -> None:
    """Nothing but the axes of the world is another."""
    copy = drawn(PRODUCT, tmp_path / "turned", functools.partial(turned, np.radians(37), np.zeros(3)))
    cell = load_workcell("panda")
    results = planned(import_product(folder(PRODUCT), "m").assembly, cell)
    results += planned(import_product(copy, "m").assembly, turned_cell(cell, np.radians(37)))
    assert about_the_same(results, noise=0.01)


def turned_cell(cell: Workcell, by: float) -> Workcell:
    """Arm, goal and obstacles turned about the vertical through the origin."""
    T = trimesh.transformations.rotation_matrix(by, [0, 0, 1])
    obstacles = tuple(replace(each, box=each.box.moved(T)) for each in cell.environment)
    return replace(cell, T_world_base=T @ cell.T_world_base, goal=T[:3, :3] @ cell.goal, environment=obstacles)
