"""The answers of the removal planner depend on the questions alone: not on threads, nor on what was asked before."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

import takeapart
from small_assemblies import three_bars
from takeapart.formats.serialization import plan_document
from takeapart.model.assembly import members
from takeapart.model.plan import Plan
from takeapart.planning import PlanningOptions, plan
from takeapart.removal.planner import RemovalPlanner
from takeapart.removal.result import Blocked, Removal
from takeapart.search.exact import ExactOptions
from verification_scene import scene_workcell

SLOW_LOADING = """
import importlib.abc, json, sys, threading
from takeapart.removal.planner import RemovalPlanner
from test_determinism import made_by

ended = threading.Event()  # some thread has answered a query
planned = RemovalPlanner.plan

def plan(*arguments, **named):
    answer = planned(*arguments, **named)
    ended.set()
    return answer

class SlowLoading(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == "ssik._ssik_native" and threading.active_count() > 1:
            assert ended.wait(60), "no other thread got on"
        return None

RemovalPlanner.plan = plan
sys.meta_path.insert(0, SlowLoading())
json.dump(made_by(2), sys.stdout)
"""


def made_by(workers: int) -> dict[str, object]:
    """The plan of three bars by exact search with so many threads, as its file holds it."""
    options = PlanningOptions(search_options=ExactOptions(workers=workers))
    made = plan(three_bars(), scene_workcell(), options)
    assert isinstance(made, Plan)
    return plan_document(replace(made, seconds=0.0))


def test_threads_that_start_while_a_library_loads_find_the_same_plan() -> None:
    """The library of inverse kinematics loads machine code at its first call and answers a second thread, as long as
    that takes, with interpreted code that rounds otherwise. Here loading takes until another thread has an answer."""
    folders = [Path(takeapart.__file__).resolve().parents[1], Path(__file__).resolve().parent]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, folders))}
    command = [sys.executable, "-c", SLOW_LOADING]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == json.loads(json.dumps(made_by(1)))


def test_an_answer_depends_on_nothing_asked_before_nor_meanwhile() -> None:
    """Every part in every state that holds it, alone and then in random orders on three threads, bit for bit."""
    planner = RemovalPlanner(three_bars(), scene_workcell())
    root = planner.assembly.root
    states = [state for state in range(root + 1) if not state & ~root]
    edges = [(state, part) for state in states for part in members(state)]

    def answer(edge: tuple[int, int]) -> object:
        state, part = edge
        return plain(planner.plan(part, state, rng=np.random.default_rng([part, state])))

    alone = {}
    for edge in edges:
        planner.forget_grasps()
        alone[edge] = answer(edge)
    assert sum(isinstance(found, tuple) for found in alone.values()) > 3, "some parts can leave"
    rng = np.random.default_rng(1)
    for _ in range(3):
        planner.forget_grasps()
        mixed = [edges[i] for i in rng.permutation(len(edges))]
        with ThreadPoolExecutor(3) as pool:
            assert dict(zip(mixed, pool.map(answer, mixed), strict=True)) == alone


def plain(answer: Removal | Blocked) -> object:
    """All of an answer, comparable bit for bit; a tuple for a removal."""
    if isinstance(answer, Blocked):
        return answer
    grasp = answer.grasp
    arrays = (grasp.center, grasp.orientation, answer.joint_path, answer.tool_path)
    return answer.length, answer.blockers, grasp.width, *(array.tobytes() for array in arrays)
