"""``takeapart train``: from recorded experience to a guide."""

from __future__ import annotations

import importlib.util
from dataclasses import asdict
from pathlib import Path

import click

from takeapart.cli.output import (
    FILE,
    FOLDER,
    examples,
    json_option,
    metres,
    note,
    print_json,
    progress_bar,
    require_output,
    seed_option,
)
from takeapart.guide.teacher_names import TEACHERS
from takeapart.model.errors import MissingExtraError


@click.command(
    short_help="Learn from recorded searches which part to remove next.",
    epilog=examples(
        "takeapart plan product.json --experience seen",
        "takeapart train seen --out guide.safetensors",
        "takeapart plan other.json --search mcts --guide guide.safetensors",
    ),
)
@click.argument("experience", type=FOLDER, nargs=-1, required=True)
@click.option("--out", type=FILE, default=Path("guide.safetensors"), show_default=True, help="The weights file.")
@click.option(
    "--teacher",
    type=click.Choice(TEACHERS),
    default="backup",
    show_default=True,
    help="backup: best continuation recorded. exact: what exact search proved. dqn: double Q-learning as in the paper.",
)
@click.option("--steps", type=click.IntRange(1), help="Gradient steps at most.  [default: 1000]")
@click.option("--layers", type=click.IntRange(1, 16), help="Layers of the graph network.  [default: 3]")
@click.option("--width", type=click.IntRange(1, 1024), help="Numbers per node and edge.  [default: 32]")
@click.option(
    "--hold-out",
    multiple=True,
    metavar="NAME",
    help="Assembly that is not learned from but decides when to stop; may be given more than once.  "
    "[default: 15 % of them, drawn]",
)
@click.option(
    "--leave-out",
    multiple=True,
    metavar="NAME",
    help="Assembly whose experience is not looked at at all; may be given more than once.",
)
@seed_option
@json_option
def train(
    experience: tuple[Path, ...],
    out: Path,
    teacher: str,
    steps: int | None,
    layers: int | None,
    width: int | None,
    hold_out: tuple[str, ...],
    leave_out: tuple[str, ...],
    seed: int,
    as_json: bool,
) -> None:
    """Train a guide on the folders EXPERIENCE, written by `takeapart plan --experience`.

    Writes the weights, and a log of the training (CSV) beside them. A training that was stopped or killed goes on when
    the same command is given again, and ends with the same weights.
    """
    for package in ("torch", "polars"):
        if importlib.util.find_spec(package) is None:
            raise MissingExtraError("takeapart train", "guide", package)
    from takeapart.guide.architecture import Architecture
    from takeapart.guide.experience import read_experience
    from takeapart.guide.training import TrainingOptions, TrainingProgress, checkpoint_path
    from takeapart.guide.training import train as train_guide

    require_output(out)
    sizes = {name: value for name, value in (("layers", layers), ("width", width)) if value is not None}
    limits = {"steps": steps} if steps is not None else {}
    options = TrainingOptions(
        teacher=teacher,  # type: ignore[arg-type]
        architecture=Architecture(**sizes),
        held_out=hold_out,
        seed=seed,
        **limits,
    )
    read = read_experience(list(experience))
    if leave_out:
        read.only(leave_out)  # refuses names that are not there
        read = read.without(leave_out)
    if checkpoint_path(out).exists():
        note(f"continuing from {checkpoint_path(out)}")
    with progress_bar(f"training, {teacher}") as update:

        def listen(progress: TrainingProgress) -> None:
            text = (
                f"regret {progress.regret:.4f} m (random {progress.random_regret:.4f} m), error {progress.error:.3f} m"
            )
            update(text, progress.step / progress.steps)

        try:
            trained = train_guide(read, options, out, listen)
        except KeyboardInterrupt:
            note("interrupted; the same command goes on from the last evaluation")
            raise
    if as_json:
        print_json({key: str(value) if isinstance(value, Path) else value for key, value in asdict(trained).items()})
        return
    judged = ", ".join(trained.held_out) or "the states learned from"
    click.echo(f"learned by           {teacher}, {trained.steps} steps, best after {trained.best_step}")
    click.echo(f"judged on            {judged}")
    click.echo(f"regret per choice    {metres(trained.regret)} (random choice: {metres(trained.random_regret)})")
    click.echo(f"error of Q-values    {metres(trained.error)}")
    click.echo(f"written to           {trained.path}, {trained.log}")
