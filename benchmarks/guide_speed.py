"""How long a guide takes: one state of 30 parts, and its share of the time of a guided search.

    OMP_NUM_THREADS=1 python benchmarks/guide_speed.py --guide FILE

Without --guide the weights are those that a training would begin with: the time does not depend on their values.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from takeapart.experiments.tables import markdown_table, replace_between_markers
from takeapart.formats.files import data_path, load_assembly, load_workcell
from takeapart.guide.architecture import Architecture
from takeapart.guide.policy import LearnedGuide, guide_path
from takeapart.guide.weights import Weights, load_weights
from takeapart.model.assembly import members
from takeapart.planning import PlanningOptions, build_problem, search
from takeapart.search.result import Budget


def drawn_weights(architecture: Architecture, seed: int) -> Weights:
    """Weights of a network that has learned nothing."""
    rng = np.random.default_rng(seed)
    arrays = {}
    for name, shape in architecture.shapes().items():
        spread = rng.normal(size=shape) / (shape[-1] if shape else 1) ** 0.5
        arrays[name] = np.asarray(np.abs(spread) + 0.1 if name.endswith("_scale") else spread, np.float32)
    return Weights(architecture, arrays, {})


def milliseconds_per_state(weights: Weights, assembly_file: str, repeats: int) -> float:
    """Median processor time for the state of all removable parts."""
    assembly = load_assembly(data_path(assembly_file))
    seconds = []
    for _ in range(repeats):
        guide = LearnedGuide(weights, assembly)
        started = time.process_time()
        guide([assembly.root])
        seconds.append(time.process_time() - started)
    return 1e3 * statistics.median(seconds)


def share_of_planning(weights: Weights, assembly_file: str, episodes: int) -> tuple[float, int]:
    """Share of the processor time of a guided MCTS that the guide takes, and the states that it computed."""
    assembly = load_assembly(data_path(assembly_file))
    learned = LearnedGuide(weights, assembly)
    spent = 0.0

    def guide(states: Sequence[int]) -> Sequence[Mapping[int, float]]:
        nonlocal spent
        started = time.process_time()
        values = learned(states)
        spent += time.process_time() - started
        return values

    options = PlanningOptions(search="mcts", budget=Budget(episodes=episodes))
    search(build_problem(assembly, load_workcell("panda"), PlanningOptions(search="random")), options)  # compiles
    problem = build_problem(assembly, load_workcell("panda"), options)
    started = time.process_time()
    search(problem, options, guide)
    return spent / (time.process_time() - started), learned.computed


def main() -> None:
    """Prints the table; with --document it replaces the one between the markers "guide speed"."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--guide", help="weights file, or default")
    parser.add_argument("--episodes", type=int, default=3, help="of the guided search")
    parser.add_argument("--repeats", type=int, default=300, help="of the forward pass")
    parser.add_argument("--document", type=Path)
    arguments = parser.parse_args()
    weights = load_weights(guide_path(arguments.guide)) if arguments.guide else drawn_weights(Architecture(), 0)
    size = f"{weights.architecture.layers} layers of {weights.architecture.width}"
    rows = []
    for file in ("single/01.json", "double/01.json"):
        parts = len(members(load_assembly(data_path(file)).root))
        time_of_state = milliseconds_per_state(weights, file, arguments.repeats)
        rows.append(
            [f"one state of {parts} parts, {size}", f"{time_of_state:.2f} ms", "<= 2 ms" if parts == 30 else ""]
        )
    share, states = share_of_planning(weights, "single/01.json", arguments.episodes)
    what = f"share of guided MCTS, {arguments.episodes} episodes, library empty, {states} states computed"
    rows.append([what, f"{100 * share:.1f} %", "< 20 %"])
    table = markdown_table(["what, processor time", "measured", "must reach"], rows)
    print(table)
    if arguments.document:
        replace_between_markers(arguments.document, "guide speed", table)


if __name__ == "__main__":
    main()
