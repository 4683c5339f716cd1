"""The pictures of the README: an animation of a plan, and how a search comes to its end.

python -m takeapart.experiments.pictures --folder docs/pictures
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from takeapart.files import data_path, load_assembly, load_workcell
from takeapart.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.render import RenderOptions, animation
from takeapart.render_output import captioned, save_animation
from takeapart.render_scene import PlanScene

ASSEMBLY, WORKCELL = "single/01.json", "panda"
WIDTH, HEIGHT, FRAMES, FRAMES_PER_SECOND = 400, 320, 6, 7.0


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
    """Length and bound against removal queries."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    history = made.search["history"]
    assert isinstance(history, list)
    pyplot.rcParams.update({"font.family": "sans-serif", "font.size": 11, "svg.hashsalt": "takeapart"})
    figure, axes = pyplot.subplots(figsize=(6.4, 3.2), layout="constrained")
    last = history[-1][0]
    for column, name, color in ((1, "length of the best plan", "#2f6fb0"), (2, "bound", "#d9822b")):
        points = [(row[0], row[column]) for row in history if row[column] is not None]
        queries, values = [x for x, _ in points], [y for _, y in points]
        axes.step([*queries, last], [*values, values[-1]], where="post", color=color, linewidth=2, label=name)
    axes.set_xlabel("removal queries")
    axes.set_ylabel("gripper path, m")
    axes.set_title(f"{made.assembly}: exact search, {len(made.steps)} parts", loc="left", fontsize=11)
    axes.grid(axis="y", color="#e3e7ec")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False)
    figure.savefig(file, metadata={"Date": None})
    pyplot.close(figure)


def main() -> int:
    """Plans the shipped assembly and draws both."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path("docs/pictures"))
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    assembly, workcell = load_assembly(data_path(ASSEMBLY)), load_workcell(WORKCELL)
    made = plan(assembly, workcell, PlanningOptions())
    if not isinstance(made, Plan):
        print(made, file=sys.stderr)
        return 3
    draw_plan(PlanScene(assembly, workcell, made), folder / "plan.gif")
    draw_search(made, folder / "search.svg")
    for file in sorted(folder.iterdir()):
        print(f"{file}: {file.stat().st_size / 1e6:.2f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
