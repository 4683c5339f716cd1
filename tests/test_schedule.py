"""Jobs of experiments: order, keeping, going on after whatever happened, and who does them."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from schedule_tasks import AddTask, diamond, done, processes
from takeapart.experiments import jobs as jobs_module
from takeapart.experiments.jobs import Job, job_keys
from takeapart.experiments.schedule import Kept, ScheduleProgress, Store, _Estimate, run_schedule
from takeapart.experiments.workers import LocalWorkers, RayWorkers, Workers, open_workers
from takeapart.model.errors import InputError, TakeapartError

SUMS = {"a/1": 1, "b/2": 3, "b/4": 5, "c/8": 16}


def run(jobs: list[Job], folder: Path, workers: Workers | None = None) -> dict[str, Kept]:
    return run_schedule(jobs, folder, workers or LocalWorkers(2))


def sums(results: dict[str, Kept]) -> dict[str, int]:
    return {name: kept.outcome["sum"] for name, kept in results.items()}


def test_jobs_get_the_files_of_those_that_they_need(tmp_path: Path) -> None:
    seen: list[ScheduleProgress] = []
    results = run_schedule(diamond(tmp_path / "log"), tmp_path / "work", LocalWorkers(2), seen.append)
    assert sums(results) == SUMS
    order = done(tmp_path / "log")
    assert order[0] == 1 and order[-1] == 8 and sorted(order) == [1, 2, 4, 8]
    assert {kept.outcome["threads"] for kept in results.values()} == {"1"}
    assert seen[0].total == 4 and max(len(progress.running) for progress in seen) == 2


def test_finished_jobs_are_not_done_again(tmp_path: Path) -> None:
    run(diamond(tmp_path / "log"), tmp_path / "work")
    results = run(diamond(tmp_path / "log"), tmp_path / "work")
    assert sums(results) == SUMS
    assert len(done(tmp_path / "log")) == 4


def test_changed_options_redo_a_job_and_all_that_need_it(tmp_path: Path) -> None:
    run(diamond(tmp_path / "log"), tmp_path / "work")
    assert sums(run(diamond(tmp_path / "log", last=9), tmp_path / "work"))["c/8"] == 17
    assert done(tmp_path / "log")[4:] == [9]
    jobs = diamond(tmp_path / "log", last=9)
    jobs[1] = Job("b/2", AddTask(3, str(tmp_path / "log")), ("a/1",))
    assert sums(run(jobs, tmp_path / "work")) == {"a/1": 1, "b/2": 4, "b/4": 5, "c/8": 18}
    assert done(tmp_path / "log")[5:] == [3, 9]


@pytest.mark.parametrize(
    "damage",
    [
        lambda work: (work / "files/b/4/deep/sum.txt").write_text("7"),
        lambda work: shutil.rmtree(work / "files/b/4"),
        lambda work: (work / "jobs/b/4.json").write_text('{"key": '),
        lambda work: (work / "jobs/b/4.json").write_text("[]"),
        lambda work: (work / "jobs/b/4.json").unlink(),
    ],
)
def test_what_is_damaged_is_done_again(tmp_path: Path, damage: object) -> None:
    assert callable(damage)
    run(diamond(tmp_path / "log"), tmp_path / "work")
    damage(tmp_path / "work")
    assert sums(run(diamond(tmp_path / "log"), tmp_path / "work")) == SUMS
    assert done(tmp_path / "log")[4:] == [4]


@pytest.mark.parametrize(("trouble", "message"), [("error", "job b/4: no luck"), ("death", "a worker process died")])
def test_a_failure_names_the_job_and_keeps_the_others(tmp_path: Path, trouble: str, message: str) -> None:
    with pytest.raises(TakeapartError, match=message):
        run(diamond(tmp_path / "log", trouble=trouble), tmp_path / "work", LocalWorkers(1))
    assert done(tmp_path / "log") == [1, 2, 4]
    assert sums(run(diamond(tmp_path / "log"), tmp_path / "work")) == SUMS
    assert done(tmp_path / "log")[3:] == [4, 8]


MAIN = """
import sys
from pathlib import Path
from schedule_tasks import diamond
from takeapart.experiments.schedule import run_schedule
from takeapart.experiments.workers import LocalWorkers

if __name__ == "__main__":
    folder = Path(sys.argv[1])
    run_schedule(diamond(folder / "log", seconds=1.0), folder / "work", LocalWorkers(2))
"""


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_run_goes_on_and_leaves_no_process(tmp_path: Path, how: signal.Signals) -> None:
    script = tmp_path / "main.py"
    script.write_text(MAIN)
    places = os.pathsep.join(sys.path)
    process = subprocess.Popen(
        [sys.executable, str(script), str(tmp_path)],
        env=os.environ | {"PYTHONPATH": places},
        stderr=subprocess.DEVNULL,
    )
    while len(done(tmp_path / "log")) < 2:  # the first job is kept, others are running
        assert process.poll() is None
        time.sleep(0.02)
    process.send_signal(how)
    assert process.wait(60) != 0
    deadline = time.monotonic() + 30
    while any(alive(number) for number in processes(tmp_path / "log")):
        assert time.monotonic() < deadline, "a worker process was left behind"
        time.sleep(0.05)
    before = len(done(tmp_path / "log"))
    assert before < 4
    assert sums(run(diamond(tmp_path / "log"), tmp_path / "work")) == SUMS
    assert 1 not in done(tmp_path / "log")[before:]


def alive(number: int) -> bool:
    try:
        return Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_two_runs_cannot_work_in_one_folder(tmp_path: Path) -> None:
    store = Store(tmp_path / "work")
    with pytest.raises(InputError, match="another process works in this folder"):
        run(diamond(tmp_path / "log"), tmp_path / "work")
    store.close()
    assert sums(run(diamond(tmp_path / "log"), tmp_path / "work")) == SUMS


def test_jobs_must_stand_after_what_they_need_and_only_once() -> None:
    first, second = Job("first", AddTask(1, ""), ("second",)), Job("second", AddTask(2, ""))
    with pytest.raises(InputError, match="job first: needs second, which must stand before it"):
        job_keys([first, second])
    with pytest.raises(InputError, match="job second: stands twice"):
        job_keys([second, second])


def test_modules_with_tasks_are_those_that_count() -> None:
    package = Path(jobs_module.__file__).parent
    holding = {path.stem for path in package.glob("*.py") if "Task:" in path.read_text() or "Task(" in path.read_text()}
    assert {f"experiments.{name}" for name in holding} >= set(jobs_module.TASKS)
    for name in jobs_module.TASKS:
        assert (package / f"{name.split('.')[1]}.py").is_file()


def test_the_time_left_follows_from_cost_and_seconds() -> None:
    jobs = [Job(name, AddTask(value, "")) for name, value in (("a/1", 10), ("a/2", 20), ("b/1", 5))]
    estimate = _Estimate(jobs, workers=2)
    nothing = estimate.progress({}, {})
    assert nothing.seconds_left is None and nothing.share == 0
    one = estimate.progress({"a/1": Kept({}, Path(), 100.0, 90.0)}, {})
    # 10 s per unit of cost: a/2 needs 200 s, b/1 by the same measure 50 s; two workers, but a/2 is one job.
    assert one.seconds_left == pytest.approx(200)
    assert one.share == pytest.approx(100 / 350)
    two = estimate.progress({"a/1": Kept({}, Path(), 100.0, 90.0), "b/1": Kept({}, Path(), 5.0, 5.0)}, {})
    assert two.seconds_left == pytest.approx(200) and two.share == pytest.approx(105 / 305)


@pytest.mark.parametrize("text", ["0", "-1", "many", "1000", "", "rays", "http://host"])
def test_unknown_workers_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="workers: .*; must be a number from 1 to 256, 'auto', 'ray' or"):
        open_workers(text)


@pytest.mark.slow
def test_a_ray_cluster_of_two_workers_gives_the_same(tmp_path: Path) -> None:
    ray = pytest.importorskip("ray")
    ray.init(
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        runtime_env={"env_vars": {"PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"}},
    )
    try:
        workers = open_workers("ray")
        assert isinstance(workers, RayWorkers) and workers.count == 2
        results = run(diamond(tmp_path / "log", seconds=0.5), tmp_path / "work", workers)
        assert sums(results) == SUMS
        assert os.getpid() not in processes(tmp_path / "log")
        jobs = diamond(tmp_path / "failing", trouble="error")
        with pytest.raises(TakeapartError, match="no luck"):
            run(jobs, tmp_path / "other", open_workers("ray"))
    finally:
        ray.shutdown()


@pytest.mark.slow
def test_a_cluster_that_is_not_there_is_told_in_one_line() -> None:
    pytest.importorskip("ray")
    with pytest.raises(TakeapartError) as told:
        open_workers("ray://127.0.0.1:9")
    assert "\n" not in str(told.value)
