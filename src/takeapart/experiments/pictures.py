"""The pictures of the README: an animation of a plan, how a search comes to its end, another arm, the shipped products.

python -m takeapart.experiments.pictures --folder docs/pictures
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.model.plan import Plan
from takeapart.pictures.output import captioned, save_animation, save_png
from takeapart.pictures.renderer import Renderer, RenderOptions, animation, chosen_view
from takeapart.planning import PlanningOptions, plan
from takeapart.report.charts import progress
from takeapart.show.scene import PlanScene

ASSEMBLY, WORKCELL = "single/01.json", "panda"
OTHER_ASSEMBLY, OTHER_WORKCELL, OTHER_STEP = "single/03.json", "ur5e", 9
WIDTH, HEIGHT, FRAMES, FRAMES_PER_SECOND = 400, 320, 6, 7.0
PRODUCT_WIDTH, PRODUCT_HEIGHT = 420, 315


def draw_plan(scene: PlanScene, file: Path) -> None:
    """The plan as a GIF, with part and length in every frame."""
    steps = scene.steps

    def frames_of(step: int) -> str:
        return f"{step + 1}  {steps[step].part}  {steps[step].length:.2f} m"

    images = animation(scene, RenderOptions(WIDTH, HEIGHT, laid_out=True), FRAMES)
    save_animation(
        (captioned(image, frames_of(number // FRAMES)) for number, image in enumerate(images)), file, FRAMES_PER_SECOND
    )


def draw_search(made: Plan, file: Path) -> None:
    """The report's chart of length and bound against removal queries, as a file of its own."""
    history, statistics = made.search["history"], made.search["statistics"]
    assert isinstance(history, list) and isinstance(statistics, dict)
    chart = progress(history, made.straight_line_bound, statistics.get("closed_queries"))
    paper = '<rect width="100%" height="100%" fill="#fff"/>'
    head, content = chart.split(">", 1)
    file.write_text(f'{head} font-family="sans-serif" font-size="14">{paper}{content}\n')


def draw_step(scene: PlanScene, step: int, file: Path) -> None:
    """One step of a plan, counted from 1, on the way to the goal."""
    moment, options = scene.moment(step - 1, 0.4), RenderOptions()
    with Renderer(scene, options, chosen_view(scene, options, [moment])) as renderer:
        save_png(renderer.picture(moment), file)


def draw_products(folder: Path) -> None:
    """Every shipped product, as it is put together."""
    folder.mkdir(parents=True, exist_ok=True)
    options = RenderOptions(PRODUCT_WIDTH, PRODUCT_HEIGHT, robot=False, soft=True)
    for file in sorted(data_path("products").glob("*/assembly.json")):
        assembly = load_assembly(file)
        scene = PlanScene(assembly, load_workcell(WORKCELL), None)
        with Renderer(scene, options, chosen_view(scene, options, None)) as renderer:
            save_png(renderer.picture(None), folder / f"{assembly.name}.png")


def main() -> int:
    """Plans shipped assemblies and draws all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("docs/pictures"))
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    draw_products(folder / "products")
    assembly, workcell = load_assembly(data_path(ASSEMBLY)), load_workcell(WORKCELL)
    made = plan(assembly, workcell, PlanningOptions())
    if not isinstance(made, Plan):
        print(made, file=sys.stderr)
        return 3
    draw_plan(PlanScene(assembly, workcell, made), folder / "plan.gif")
    draw_search(made, folder / "search.svg")
    assembly, workcell = load_assembly(data_path(OTHER_ASSEMBLY)), load_workcell(OTHER_WORKCELL)
    other = plan(assembly, workcell, PlanningOptions())
    if not isinstance(other, Plan):
        print(other, file=sys.stderr)
        return 3
    draw_step(PlanScene(assembly, workcell, other), OTHER_STEP, folder / "ur5e.png")
    for file in sorted(file for file in folder.rglob("*") if file.is_file()):
        print(f"{file}: {file.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
