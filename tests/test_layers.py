"""The import table of the design: a module imports only what stands above it.

`model.plan` stands right after `model.assembly`: it is data only, and the result of a removal holds a grasp of it.
"""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "takeapart"

# From top to bottom. A name is a module, or a package with all of its modules that do not stand above it. Modules that
# match the same name may import each other.
LAYERS = """
_moved
model.errors
caching
compilation
states
model.geometry
model.bounding
model.voxels
model.revolving
model.covering
model.meshes
model.assembly
model.plan
model
workcell
formats.messages
formats.bound_texts
formats.schemas
formats.documents
formats.mesh_files
formats.shipped
formats.robot_schemas
formats.robot_files
formats.robot_writing
formats.serialization
formats.files
formats.sources
formats
generate.profile_layout
generate.profiles
generate.cells
generate
stability.contact
stability
collision
robot
motion
removal
problem
search
guide
planning
verification
show
pictures
viewer
page
report
experiments
cli
""".split()

# Where a library with a large footprint, or one that is an optional extra, may be imported.
CONFINED = {
    "fcl": ("verification.solids",),
    "manifold3d": ("verification.solids", "formats.importing", "generate.products.solids"),
    "mujoco": ("verification", "pictures"),
    "torch": ("guide",),
    "safetensors": ("guide",),
    "polars": ("guide",),
    "viser": ("viewer",),
    "yourdfpy": ("robot.urdf", "show.robot"),
    "xacro": ("robot.urdf", "verification.urdf"),
    "imageio": ("pictures",),
    "PIL": ("pictures",),
    "matplotlib": ("pictures", "report", "experiments"),
    "ray": ("experiments",),
    "ssik": ("robot.ik_solver",),
    "pydantic": ("formats.schemas", "formats.robot_schemas"),
    "pydantic_core": ("formats.schemas", "formats.robot_schemas", "formats.messages"),
    "sqlite3": ("planning.run_journal",),
    "click": ("cli",),
    "rich": ("cli",),
}

# The verification shares no collision, kinematics, or rule with what it checks.
FORBIDDEN_TO_VERIFICATION = (
    "collision",
    "robot",
    "motion",
    "removal",
    "stability",
    "problem",
    "search",
    "guide",
    "planning",
)


def matches(module: str, pattern: str) -> bool:
    """Whether a module (dotted, without the package's name) is what a name of the table stands for."""
    return module == pattern or module.startswith(pattern + ".")


def layer(module: str) -> int:
    found = [i for i, pattern in enumerate(LAYERS) if matches(module, pattern)]
    assert found, f"{module} stands in no layer: add it to the table of docs/design.md and of this test"
    return found[0]


def module_name(path: Path) -> str:
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(source: str, module: str, is_package: bool = False) -> set[str]:
    """Full dotted names of all imports, also those inside functions; ``from a import b`` counts as a and as a.b."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            here = f"takeapart.{module}".rstrip(".").split(".")
            above = here[: len(here) - node.level + (1 if is_package else 0)] if node.level else []
            start = ".".join([*above, *([node.module] if node.module else [])])
            names |= {start} | {f"{start}.{alias.name}" for alias in node.names}
    return names


def findings(module: str, names: set[str], own_modules: set[str]) -> list[str]:
    """What breaks the rules, one line each."""
    own = {name.removeprefix("takeapart.") for name in names} & own_modules
    found = []
    if module and module != "__main__":
        found = [
            f"{module} imports {name}, which stands below it" for name in sorted(own) if layer(name) > layer(module)
        ]
    if matches(module, "verification"):
        found += [
            f"{module} imports {name}, which it is there to check"
            for name in sorted(own)
            if any(matches(name, part) for part in FORBIDDEN_TO_VERIFICATION)
        ]
    for library in sorted({name.split(".")[0] for name in names} & set(CONFINED)):
        if not any(matches(module, pattern) for pattern in CONFINED[library]):
            found.append(f"{module} imports {library}; only {', '.join(CONFINED[library])} may")
    return found


SOURCES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


@pytest.mark.parametrize("module", [module for module in SOURCES if module not in ("", "__main__")])
def test_module_imports_only_what_stands_above(module: str) -> None:
    path = SOURCES[module]
    names = imported(path.read_text(), module, path.name == "__init__.py")
    assert findings(module, names, set(SOURCES)) == []


def test_the_package_itself_imports_no_optional_library() -> None:
    names = imported(SOURCES[""].read_text(), "", is_package=True)
    assert not {name.split(".")[0] for name in names} & set(CONFINED)


@pytest.mark.parametrize(
    ("module", "source", "message"),
    [
        (
            "model.geometry",
            "from takeapart.model.assembly import Part",
            "model.geometry imports model.assembly, which stands below it",
        ),
        ("model.geometry", "def f():\n    import takeapart.cli", "model.geometry imports cli, which stands below it"),
        ("search.mcts", "from takeapart import planning", "search.mcts imports planning, which stands below it"),
        ("search.mcts", "from ..guide import policy", "search.mcts imports guide.policy, which stands below it"),
        (
            "verification.replay",
            "from takeapart.robot import ik",
            "verification.replay imports robot.ik, which it is there to check",
        ),
        ("planning.plans", "import mujoco.viewer", "planning.plans imports mujoco; only verification, pictures may"),
        ("robot.kernels", "from ssik import x", "robot.kernels imports ssik; only robot.ik_solver may"),
        (
            "formats.files",
            "import pydantic",
            "formats.files imports pydantic; only formats.schemas, formats.robot_schemas may",
        ),
    ],
)
def test_breaches_are_found(module: str, source: str, message: str) -> None:
    modules = {
        "model.geometry",
        "model.assembly",
        "cli",
        "planning",
        "guide",
        "guide.policy",
        "robot",
        "robot.ik",
    }
    assert message in findings(module, imported(source, module), modules)


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("search.mcts", "from takeapart.search.result import Clock\nfrom . import bounds\nimport numpy"),
        ("verification.replay", "import mujoco\nfrom takeapart.formats.files import load_plan"),
        ("robot.ik_solver", "from ssik.prebuilt import franka_panda_ik"),
        ("cli.demo", "from takeapart import verification, planning"),
    ],
)
def test_what_is_allowed_is_not_found(module: str, source: str) -> None:
    modules = {"search.result", "search.bounds", "formats.files", "verification", "planning"}
    assert findings(module, imported(source, module), modules) == []
