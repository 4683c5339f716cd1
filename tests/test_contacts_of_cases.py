"""How near parts of products are that others drew, against what trimesh and manifold3d measured."""

from __future__ import annotations

import pytest

from mesh_cases import CASES, case, facts
from takeapart.collision.contact import Contacts
from takeapart.collision.fields import FIELD_ERROR
from takeapart.verification.solids import Solid, overlap_depth

NAMES = [
    "asap_beam", "choreo_bricks", "fabrica_car", "fabrica_cooling_manifold", "fabrica_duct", "fabrica_gamepad",
    "fabrica_plumbers_block", "factory_pegs", "furniture_drawer", "furniture_square_table", "o2ac_wrs_assembly_2020",
    "so100_arm",
]  # fmt: skip
SAMPLED = 0.1  # share of a depth that points 2 mm apart may miss


def test_no_case_with_facts_is_forgotten() -> None:
    if not CASES.is_dir():
        pytest.skip("no products of others: they are no part of the project")
    assert sorted(file.parent.name for file in CASES.glob("*/meta.json")) == sorted(NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_gaps_and_depths_are_those_that_others_measured(name: str) -> None:
    """Gaps against the facts beside the product. Depths against the common volume: the depths among the facts are
    those of crossing triangles, also where nothing is common (a pin of 24 edges in a hole of 24 edges)."""
    assembly = case(name)
    contacts = Contacts(assembly)
    solids = [Solid(part.shape.surface()) for part in assembly.parts]
    gaps, depths, wrong = [0.0], [0.0], []
    pairs = facts(name)["pairs"]
    assert isinstance(pairs, list) and pairs
    for pair in pairs:
        a, b = assembly.index[pair["a"]], assembly.index[pair["b"]]
        found = contacts.finding(a, b)
        assert found is not None, f"{pair['a']} and {pair['b']} are not near"
        error = FIELD_ERROR * max(contacts.body(a).field.step, contacts.body(b).field.step)
        gaps.append(abs(found.gap - 1e-3 * pair["gap_mm"]))
        if gaps[-1] > error:
            wrong.append((pair["a"], pair["b"], "gap", found.gap, 1e-3 * pair["gap_mm"]))
        if solids[a].is_closed and solids[b].is_closed:
            truth = overlap_depth(solids[a], assembly.parts[a].T_world_part, solids[b], assembly.parts[b].T_world_part)
            depths.append(abs(found.depth - truth))
            if depths[-1] > error + SAMPLED * truth:
                wrong.append((pair["a"], pair["b"], "depth", found.depth, truth))
    print(f"{name}: {len(pairs)} pairs, gaps to {1e3 * max(gaps):.3f} mm, depths to {1e3 * max(depths):.3f} mm")
    assert not wrong
