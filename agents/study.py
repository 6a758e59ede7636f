"""Doing the jobs of a study: some at once, each a process of its own; what is done is kept, what was stopped goes on."""

import datetime
import fcntl
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import gymnasium as gym
import yaml
from rich.console import Console

from agents.candidate_policy import read_candidates
from agents.interruption import Interruption
from agents.progress import ProgressReport
from agents.run_folder import versions
from agents.study_config import SCRIPTS, StudyConfig
from agents.study_jobs import (
    DONE,
    FAILED,
    STUDY_FILE,
    UNFINISHED,
    Job,
    Stamp,
    inputs_of,
    jobs_of,
    read_stamp,
    state_of,
    write_stamp,
)
from gmapspring.errors import GmapspringError
from gmapspring.paths import write_atomically

COMMAND = (sys.executable, "-m", "agents")
ONE_THREAD = {"NUMBA_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MKL_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
"""One core for each job, so that CPU time means the same however many run at once."""
LOOK_INTERVAL = 0.2
"""Time between two looks at the jobs that run [s]."""


class StudyError(GmapspringError, RuntimeError):
    """A study that cannot be done as asked."""


class Choice(NamedTuple):
    """What of a study is to be done now."""

    rows: list[str]
    """Names of rows, or `scripts`; empty for all. What they start from is done too."""
    seeds: list[int]
    """Empty for all."""


def run_study(study: StudyConfig, folder: pathlib.Path, choice: Choice, n_at_once: int, console: Console) -> int:
    """Do what is not done yet, and return the exit code: 0 done; 1 something failed; 128 + signal when interrupted."""
    names = study.needed_by(choice.rows)
    if unknown := set(choice.seeds).difference(*map(study.seeds_of, study.rows)):
        raise StudyError(f"no row of study {study.name!r} has the seeds {sorted(unknown)}")
    folder.mkdir(parents=True, exist_ok=True)
    with _alone_in(folder) as lock, ProgressReport(console, study.name) as report:
        asked = study.model_dump(mode="json", by_alias=True, exclude_none=True)
        write_atomically(folder / STUDY_FILE, yaml.safe_dump(asked, sort_keys=False).encode())
        jobs = [job for job in jobs_of(study, folder) if _is_chosen(job, names, choice.seeds)]
        if any(job.played is None and state_of(job)[0] != DONE for job in jobs):
            report.note("compiling kernels, if that was not done before")
            compile_kernels(study.rows[0].evaluate[0].scene)
        work = Work(jobs, n_at_once, lock, report)
        stopped_by = work.run()
    for job, message in work.failed.items():
        console.print(f"failed: {job}: {message}", highlight=False, markup=False, soft_wrap=True)
    if stopped_by is not None:
        console.print("interrupted; the same command goes on where it stopped", highlight=False)
        return 128 + stopped_by
    return 1 if work.failed else 0


def compile_kernels(scene: str) -> None:
    """Play a few steps, alone and in a batch: compilation is once per machine, and no part of a run's CPU time."""
    env = gym.make("envs:Resect-v0", scene=scene)
    observation, _ = env.reset(seed=0)
    read_candidates({name: part[None] for name, part in observation.items()})
    env.step(observation["action_mask"].argmax())
    envs = gym.make_vec("envs:Resect-v0", num_envs=2, vectorization_mode="vector_entry_point", scene=scene)
    observations, _ = envs.reset(seed=0)
    read_candidates(observations)
    envs.step(observations["action_mask"].argmax(axis=1))


def _is_chosen(job: Job, names: set[str], seeds: list[int]) -> bool:
    """Return whether a job is among rows and seeds; no names or no seeds stand for all."""
    is_named = not names or (SCRIPTS if job.seed is None else job.row) in names
    return is_named and (not seeds or job.seed is None or job.seed in seeds)


@contextmanager
def _alone_in(folder: pathlib.Path) -> Iterator[int]:
    """Hold the folder's lock; children inherit it, so that those of a study that was killed are not disturbed either."""
    with (folder / ".lock").open("w") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StudyError(f"another study, or what is left of one, is at work in {folder}; wait for it or end it") from None
        yield stream.fileno()


class Running(NamedTuple):
    """A job at work."""

    job: Job
    process: "subprocess.Popen[bytes]"
    stamp: Stamp
    since: float
    """When it began, by `time.monotonic` [s]."""


class Work:
    """Jobs that wait, that run, that are done and that failed."""

    def __init__(self, jobs: Sequence[Job], n_at_once: int, lock: int, report: ProgressReport) -> None:
        """Take the jobs in order; nothing is started yet."""
        self._waiting, self._n_at_once, self._lock, self._report = list(jobs), n_at_once, lock, report
        self._running: list[Running] = []
        self._total, self._spent = sum(job.seconds for job in jobs), 0.0
        self._made = versions()
        self.done: set[str] = set()
        self.failed: dict[str, str] = {}
        """What went wrong, by name of the job."""

    def run(self) -> int | None:
        """Do the jobs; return the signal that interrupted, after the jobs at work have saved what they have."""
        is_told = False
        with Interruption() as interruption:
            try:
                while self._waiting or self._running:
                    if interruption.signal is None:
                        self._start_what_can()
                    elif not is_told:
                        self._waiting.clear()
                        self._tell(signal.SIGINT)
                        is_told = True
                    self._collect(interruption.signal is not None)
                    self._show()
                    time.sleep(LOOK_INTERVAL)
            except KeyboardInterrupt:
                # The second request: training keeps its last checkpoint.
                self._tell(signal.SIGKILL)
        return interruption.signal

    def _start_what_can(self) -> None:
        """Start jobs in order while there is room; pass over those that are done, or whose need has failed."""
        for job in list(self._waiting):
            if job.needs in self.failed:
                self._waiting.remove(job)
                self._count_as_failed(job, f"not done, for {job.needs} failed")
            elif job.needs is None or job.needs in self.done:
                if state_of(job)[0] == DONE:
                    self._waiting.remove(job)
                    self._count_as_done(job)
                elif len(self._running) < self._n_at_once:
                    self._waiting.remove(job)
                    self._start(job)

    def _start(self, job: Job) -> None:
        """Start a job, from the beginning or from where it was stopped."""
        inputs = inputs_of(job)
        made = {"date": datetime.date.today().isoformat(), **self._made}
        stamp, before = Stamp(inputs, UNFINISHED, "", made), read_stamp(job)
        arguments = list(job.arguments)
        if job.played is None:
            if not (job.place / "last.zip").exists():
                shutil.rmtree(job.place, ignore_errors=True)
            elif before and before.inputs["files"] != inputs["files"]:
                self._fail(job, f"what it is made from has changed since it began; delete {job.place} to train again")
                return
            else:
                arguments.append("--resume")
        write_stamp(job, stamp)
        with job.log.open("wb") as log:
            process = subprocess.Popen(
                [*COMMAND, *arguments],
                stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT, env=os.environ | ONE_THREAD,
                # Ctrl-C reaches this process alone, which passes it on once.
                start_new_session=True, pass_fds=(self._lock,),
            )  # fmt: skip
        self._running.append(Running(job, process, stamp, time.monotonic()))

    def _collect(self, is_interrupted: bool) -> None:
        """Take note of the jobs that have ended."""
        for running in list(self._running):
            code = running.process.poll()
            if code is None:
                continue
            self._running.remove(running)
            job = running.job
            if code == 0:
                write_stamp(job, running.stamp._replace(outcome=DONE))
                self._count_as_done(job)
                self._report.note(f"{job.name}: {last_line(job.log) if job.played is None else DONE}")
            elif not is_interrupted:
                self._fail(job, f"exit code {code}: {last_line(job.log)}")

    def _count_as_done(self, job: Job) -> None:
        self.done.add(job.name)
        self._spent += job.seconds

    def _fail(self, job: Job, message: str) -> None:
        """Write down that a job failed; it is tried again when the study is run again."""
        stamp = read_stamp(job)
        assert stamp is not None, "only a job that was started can fail"
        write_stamp(job, stamp._replace(outcome=FAILED, message=message))
        self._count_as_failed(job, message)

    def _count_as_failed(self, job: Job, message: str) -> None:
        self.failed[job.name] = message
        self._spent += job.seconds
        self._report.note(f"{job.name}: {message}")

    def _tell(self, number: int) -> None:
        """Send a signal to all jobs at work."""
        for running in self._running:
            running.process.send_signal(number)

    def _show(self) -> None:
        """Show how far the study is; how long a job lasts is a guess."""
        now = time.monotonic()
        begun = sum(min(now - running.since, 0.95 * running.job.seconds) for running in self._running)
        names = ", ".join(running.job.name for running in self._running)
        self._report.update((self._spent + begun) / max(self._total, 1.0), names)


def last_line(path: pathlib.Path) -> str:
    """Return the last line that says something."""
    lines = [line.strip() for line in path.read_text(encoding="utf-8", errors="replace").splitlines()]
    return next((line for line in reversed(lines) if line), "it printed nothing")
