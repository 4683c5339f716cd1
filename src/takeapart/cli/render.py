"""``takeapart render``: pictures and animations of assemblies and plans."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from takeapart.cli.output import (
    FILE,
    FiniteNumber,
    examples,
    json_option,
    metres,
    note,
    plan_assembly_option,
    plan_workcell_option,
    print_json,
    progress_bar,
    require_output,
)
from takeapart.formats.plan_texts import title_of
from takeapart.model.errors import InputError
from takeapart.show.directions import DIRECTIONS

if TYPE_CHECKING:
    from takeapart.model.plan import Plan
    from takeapart.pictures.renderer import Image


VIEW = click.Choice(list(DIRECTIONS))


def sheet_title(plan: Plan) -> str:
    """What stands above the pictures of all steps."""
    taken, removable = len(plan.steps), len(plan.steps) + len(plan.remaining)
    share = f", {taken} of {removable} parts" if plan.remaining else ""
    return f"{title_of(plan)}{share}, {metres(plan.total_length)}"


@click.command(
    short_help="Draw an assembly or a plan: PNG, GIF or MP4.",
    epilog=examples(
        "takeapart render product.json --out product.png --view front",
        "takeapart render product.plan.json --sheet --out steps.png",
        "takeapart render product.plan.json --out plan.gif",
    ),
)
@click.argument("file", type=FILE)
@click.option("--out", type=FILE, required=True, help="The picture (.png) or animation (.gif, .mp4).")
@click.option("--sheet", is_flag=True, help="One sheet with a small picture of every step of the plan.")
@click.option("--step", type=click.IntRange(1), help="A picture of one step of the plan, counted from 1.")
@click.option(
    "--at",
    type=FiniteNumber(0, 1),
    default=0.4,
    show_default=True,
    help="Which moment of a step is drawn: 0 at the grasp, 1 at the goal.",
)
@click.option("--view", type=VIEW, default="corner", show_default=True, help="Where the camera stands.")
@click.option("--robot/--no-robot", default=None, help="Whether the arm is drawn.  [default: with a plan]")
@click.option("--laid-out", is_flag=True, help="Removed parts lie beside the assembly; otherwise they are hidden.")
@click.option("--width", type=click.IntRange(64, 4096), help="Pixels.  [default: 1200; sheet 400; animation 640]")
@click.option("--height", type=click.IntRange(64, 4096), help="Pixels.  [default: three quarters of the width]")
@click.option(
    "--frames", type=click.IntRange(2, 240), default=10, show_default=True, help="Of an animation, for every step."
)
@click.option("--fps", type=FiniteNumber(1, 60), default=12.0, show_default=True, help="Frames per second.")
@plan_assembly_option
@plan_workcell_option
@json_option
def render(
    file: Path,
    out: Path,
    sheet: bool,
    step: int | None,
    at: float,
    view: str,
    robot: bool | None,
    laid_out: bool,
    width: int | None,
    height: int | None,
    frames: int,
    fps: float,
    assembly: Path | None,
    workcell: str | None,
    as_json: bool,
) -> None:
    """Draw FILE, an assembly, a plan or a run directory, without a window.

    A .png shows the whole assembly, one step of a plan (--step) or all of them (--sheet); a .gif or .mp4 plays the
    plan. Needs the extra "view" (pip install 'takeapart[view]') and OpenGL, which may be Mesa's in software.
    """
    kind = out.suffix.lower()
    if kind not in (".png", ".gif", ".mp4"):
        raise InputError(f"unknown ending {kind!r}; give a name that ends in .png, .gif or .mp4", str(out))
    if sheet and step is not None:
        raise click.UsageError("--sheet shows all steps and --step one of them; give one of both")
    if kind != ".png" and (sheet or step is not None):
        raise click.UsageError("--sheet and --step make a .png; an animation shows all steps")
    require_output(out, file)

    from takeapart.pictures.output import captioned, contact_sheet, save_animation, save_png
    from takeapart.pictures.renderer import Renderer, RenderOptions, animation, chosen_view
    from takeapart.show.scene import PlanScene
    from takeapart.show.subject import load_subject

    subject = load_subject(file, assembly, workcell)
    scene = PlanScene(subject.assembly, subject.workcell, subject.plan)
    wants_steps = sheet or step is not None or kind != ".png"
    if wants_steps and not scene.steps:
        raise InputError("holds no plan; --sheet, --step and animations need one", str(file))
    if step is not None and step > len(scene.steps):
        raise InputError(f"{step}; the plan has {len(scene.steps)} steps", "--step")
    pixels = width or (400 if sheet else 1200 if kind == ".png" else 640)
    tall = height or pixels * 3 // 4
    if kind == ".mp4":
        pixels, tall = pixels // 2 * 2, tall // 2 * 2
    with_robot = subject.plan is not None if robot is None else robot
    options = RenderOptions(pixels, tall, view, with_robot, laid_out=laid_out, soft=kind == ".png")
    order = range(len(scene.steps)) if scene.direction == "disassembly" else range(len(scene.steps) - 1, -1, -1)
    captions = [f"{i + 1}  {scene.steps[k].part}  {metres(scene.steps[k].length)}" for i, k in enumerate(order)]
    with progress_bar(f"drawing {subject.assembly.name}") as update:
        if kind != ".png":
            total = frames * len(captions)

            def drawn() -> Iterator[Image]:
                for number, image in enumerate(animation(scene, options, frames)):
                    update(f"frame {number + 1} of {total}", number / total)
                    yield captioned(image, captions[number // frames])

            save_animation(drawn(), out, fps)
        else:
            moment = None if step is None else scene.moment(order[step - 1], at)
            shown_moments = None if moment is None else [moment]
            with Renderer(scene, options, chosen_view(scene, options, shown_moments)) as renderer:
                if sheet:
                    images = []
                    for number, k in enumerate(order):
                        update(captions[number], number / len(captions))
                        images.append(renderer.picture(scene.moment(k, at)))
                    title = "" if subject.plan is None else sheet_title(subject.plan)
                    save_png(contact_sheet(images, captions, title), out)
                else:
                    picture = renderer.picture(moment)
                    save_png(picture if step is None else captioned(picture, captions[step - 1]), out)
    if as_json:
        print_json({"file": str(out), "bytes": out.stat().st_size})
    else:
        note(f"written to {out}")
