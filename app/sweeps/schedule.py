"""The order in which a sweep's jobs are done: each odometry once, before the runs that need it; never too many at once."""

import statistics
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from dataclasses import dataclass, field
from typing import Any

from ffmap.app.folder import figures
from ffmap.app.folder.names import METRICS, RunFolder
from ffmap.app.run.odometry_cache import is_complete
from ffmap.app.sweeps.one_run import Job, Outcome, is_finished, perform
from ffmap.app.sweeps.plan import Combination, Search
from ffmap.loaders.text_files import read_object


@dataclass(eq=False)
class Run:
    """One run of the sweep: what it is to do, and what came of it.

    odometry: the name of the one that it needs, as the cache knows it; None where the poses are given. reused: whether the
    run was finished before.
    """

    job: Job
    combination: Combination
    odometry: str | None
    outcome: Outcome | None = None
    reused: bool = False
    figures: dict[str, float] = field(default_factory=dict)
    record: dict[str, Any] = field(default_factory=dict)

    @property
    def error(self) -> str | None:
        """What went wrong; None where nothing did, as yet."""
        return self.outcome.error if self.outcome is not None else None

    def end(self, outcome: Outcome) -> None:
        self.outcome = outcome
        if outcome.error is None:
            self.record = RunFolder(self.job.out).read_json()
            metrics = self.job.out / METRICS
            known = read_object(metrics, "run the sweep again") if metrics.exists() else None
            self.figures = figures.figures_of(self.record, known)


class Schedule:
    """Takes combinations from a search, as many as there is room for, and tells it what came of them."""

    def __init__(
        self,
        search: Search,
        runs_of: Callable[[Combination], Sequence[Run]],
        objective: str,
        on_end: Callable[[Run], None],
    ) -> None:
        """runs_of: the runs of a combination, one for each bag. on_end: called with every run that has ended.

        runs: all that were proposed until now, by their names. odometries: those computed here; None while it goes on.
        """
        self._search, self._runs_of, self._objective, self._on_end = search, runs_of, objective, on_end
        self.runs: dict[str, Run] = {}
        self.odometries: dict[str, Outcome | None] = {}
        self._waiting: list[Run] = []
        self._running: dict[Future[Outcome], Run | str] = {}
        self._untold: list[tuple[Combination, list[Run]]] = []

    def perform(self, executor: Executor, slots: Callable[[], int]) -> None:
        """Do everything. slots: how many jobs the executor takes at once, which may change."""
        while True:
            self._fill(executor, slots())
            if not self._running:
                return
            done, _ = wait(self._running, return_when=FIRST_COMPLETED)
            for future in done:
                self._end(self._running.pop(future), future)

    def _fill(self, executor: Executor, slots: int) -> None:
        slots = max(slots, 1)
        while len(self._running) < slots:
            proposed = False
            while len(self._waiting) < slots and self._propose():
                proposed = True
            job = self._next_job()
            if job is not None:
                self._running[executor.submit(perform, job[1])] = job[0]
            elif not proposed:
                return

    def _propose(self) -> bool:
        """Make the runs of one more combination; whether there was one."""
        combination = self._search.next()
        if combination is None:
            return False
        # A search may propose the same twice.
        runs = [self.runs.setdefault(run.job.name, run) for run in self._runs_of(combination)]
        self._untold.append((combination, runs))
        for run in runs:
            if run.outcome is not None or run in self._waiting or run in self._running.values():
                continue
            if is_finished(run.job):
                run.reused = True
                self._take(run, _THERE)
            else:
                self._waiting.append(run)
        self._tell()
        return True

    def _next_job(self) -> tuple[Run | str, Job] | None:
        """A run whose odometry is there, or an odometry that nobody computes yet; None where all has to wait."""
        for run in list(self._waiting):
            key = run.odometry
            if key is not None and key not in self.odometries and not is_complete(run.job.cache / "odometry" / key):
                self.odometries[key] = None
                return key, run.job.model_copy(update={"odometry": key})
            outcome = self.odometries.get(key, _THERE) if key is not None else _THERE
            if outcome is None:
                continue
            self._waiting.remove(run)
            if outcome.error is None:
                return run, run.job
            self._take(run, Outcome(seconds=0.0, error=f"its odometry failed: {outcome.error}"))
        return None

    def _end(self, ended: Run | str, future: Future[Outcome]) -> None:
        # A cluster may lose a job with its worker.
        lost = future.exception()
        outcome = future.result() if lost is None else Outcome(seconds=0.0, error=f"lost by the cluster: {lost}")
        if isinstance(ended, Run):
            self._take(ended, outcome)
        else:
            self.odometries[ended] = outcome

    def _take(self, run: Run, outcome: Outcome) -> None:
        run.end(outcome)
        self._on_end(run)
        self._tell()

    def _tell(self) -> None:
        for combination, runs in list(self._untold):
            if all(run.outcome is not None for run in runs):
                self._untold.remove((combination, runs))
                values = [run.figures.get(self._objective) for run in runs]
                known = [value for value in values if value is not None]
                self._search.tell(combination, statistics.fmean(known) if len(known) == len(values) else None)


_THERE = Outcome(seconds=0.0)
