"""From the command line's words to a sweep that can begin: its bags, settings, folder and workers, all checked."""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ffmap.app.folder import figures
from ffmap.app.folder.names import PROGRAM, SweepFile, require_writable
from ffmap.app.parameters import SweepParameters, one_for_each_core
from ffmap.app.run.odometry import name_of
from ffmap.app.run.odometry_cache import cache_folder
from ffmap.app.run.start import Arguments
from ffmap.app.setup.inputs import Inputs, digest_clouds, find_inputs, total_digest
from ffmap.app.setup.outputs import SWEEP_OUTPUTS, Output, parse_outputs
from ffmap.app.setup.settings import Settings, load_settings
from ffmap.app.setup.versions import versions
from ffmap.app.sweeps import plan
from ffmap.app.sweeps.one_run import Job, overrides_of, stop_all
from ffmap.app.sweeps.plan import Combination, Parameter, Search, Study
from ffmap.app.sweeps.schedule import Run
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_json
from ffmap.loaders.truth import carries_truth

_MARK = ".shared"


@dataclass(frozen=True)
class Sweep:
    """What a sweep is made from, all of it checked.

    truth: whether every bag carries it, so that runs have metrics. clouds: for each bag, the digest of all clouds of each
    topic that runs read.
    """

    words: SweepParameters
    base: Settings
    parameters: tuple[Parameter, ...]
    outputs: tuple[Output, ...]
    bags: tuple[Inputs, ...]
    truth: bool
    clouds: Mapping[BagPath, Mapping[str, str]]
    out: Path

    def search(self) -> Search:
        """Where the combinations come from; raises InputError where Optuna is wanted and not installed."""
        words = self.words
        if words.optuna is not None:
            return Study(self.parameters, words.optuna, words.seed, words.objective, self.out / SweepFile.STUDY)
        if words.random is not None:
            return plan.random_of(self.parameters, words.random, words.seed)
        return plan.grid_of(self.parameters)

    def runs_of(self, combination: Combination, cache: Path) -> list[Run]:
        """One run for each bag. cache: the folder of the odometries."""
        settings, words = plan.apply(self.base, combination), self.words
        stems = [inputs.bag_path.stem for inputs in self.bags]
        runs = []
        for inputs in self.bags:
            stem, clouds = inputs.bag_path.stem, self.clouds[inputs.bag_path]
            digest = total_digest(clouds)
            name = stem if stems.count(stem) == 1 else f"{stem}-{digest[:6]}"
            arguments = Arguments(
                bag=inputs.bag_path,
                out=self.out / f"{name}-{settings.short_hash()}",
                overrides=overrides_of(settings),
                bag_options=words.bag_options,
                trajectory=_absolute(words.trajectory),
                mount=words.mount,
                detail=words.detail.value,
                outputs=self.outputs,
                workers=1,
                evaluate=self.truth,
                quiet=True,
                overwrite=True,
            )
            job = Job(arguments=arguments, bag_digest=digest, settings_hash=settings.short_hash(), cache=cache)
            odometry = None
            if words.trajectory is None and inputs.horizontal is not None:
                odometry = name_of(inputs, inputs.horizontal, settings, clouds)
            runs.append(Run(job, combination, odometry))
        return runs


def make_ready(words: SweepParameters) -> Sweep:
    """Check everything, make the folder; raises InputError before anything starts where something is wrong."""
    outputs = parse_outputs(words.outputs, SWEEP_OUTPUTS)
    base = load_settings(words.config, words.set_ or ())
    if words.random is not None and words.optuna is not None:
        raise InputError("--random and --optuna: choose one of them")
    searched = words.random is not None or words.optuna is not None
    parameters = plan.parse_grid(words.grid or (), base, ranges=searched)
    if not words.bags:
        raise InputError("give a bag; 'ffmap sweep --help' has examples")
    bags = tuple(find_inputs(bag, words.bag_options) for bag in dict.fromkeys(path.resolve() for path in words.bags))
    for inputs in bags:
        if inputs.vertical is None:
            raise InputError(f"{inputs.bag_path}: has no lidar that sweeps the walls; there is nothing to label")
        if inputs.horizontal is None and words.trajectory is None:
            raise InputError(f"{inputs.bag_path}: no horizontal lidar gives poses; give --horizontal or --trajectory")
    truth = words.evaluate and all(carries_truth(inputs.bag_path) for inputs in bags)
    if truth and not {Output.LABELS, Output.LABELLED} & set(outputs):
        raise InputError("--outputs: without labels or labelled no run can be compared with the truth; add labels")
    figures.check_objective(words.objective, truth or words.optuna is None)
    given = words.trajectory is not None
    clouds = {inputs.bag_path: digest_clouds(inputs.bag_path, inputs.used(given)) for inputs in bags}
    out = (words.out or _default_out(words, outputs, clouds, base)).resolve()
    _create(out)
    return Sweep(words, base, parameters, outputs, bags, truth, clouds, out)


def _default_out(
    words: SweepParameters, outputs: tuple[Output, ...], clouds: Mapping[BagPath, Mapping[str, str]], base: Settings
) -> Path:
    """The same for the same command and program, so that a sweep that was killed goes on."""
    said: list[object] = [words.grid, words.random, words.optuna, words.objective, words.seed]
    said += [outputs, words.detail, words.trajectory, words.time_from]
    said += [[total_digest(read) for read in clouds.values()], base.short_hash(), versions()]
    digest = hashlib.sha256(json.dumps(said).encode()).hexdigest()[:8]
    return Path("runs") / f"sweep-{next(iter(clouds)).stem}-{digest}"


def _create(out: Path) -> None:
    """Raises InputError where the folder cannot be written or holds something else."""
    require_writable(out, "give another folder to --out")
    if any(out.iterdir()) and not _is_sweep(out):
        raise InputError(f"{out}: holds files that are no sweep; give an empty or a new folder to --out")


def _is_sweep(folder: Path) -> bool:
    try:
        return bool(read_json(folder / SweepFile.JSON, "")["program"] == PROGRAM)
    except (InputError, LookupError, TypeError):
        return False


def _absolute(trajectory: str | None) -> str | None:
    """A file by its whole path, for the processes of a cluster work elsewhere; a topic as it is."""
    return str(Path(trajectory).resolve()) if trajectory is not None and Path(trajectory).exists() else trajectory


@contextmanager
def workers_of(sweep: Sweep) -> Iterator[tuple[Executor, Callable[[], int], Path]]:
    """Who does the runs, how many at once, and where the odometries are kept that they share."""
    own, scheduler = cache_folder().parent, sweep.words.scheduler
    if scheduler is None:
        at_once = one_for_each_core(sweep.words.workers)
        # Each thread waits for a process.
        executor = ThreadPoolExecutor(at_once)
        try:
            yield executor, lambda: at_once, own if _can_write(own) else sweep.out
        finally:
            executor.shutdown(wait=False, cancel_futures=True)
            stop_all(sweep.out)
        return
    from ffmap.app.run.cluster import connect

    # A worker sees the folder if it sees what lies in it.
    needed = [sweep.out / SweepFile.JSON, *(part for inputs in sweep.bags for part in inputs.bag_path.parts)]
    with connect(scheduler, needed, partial(stop_all, sweep.out)) as cluster:
        shared = _can_write(own) and cluster.all_see(own / _MARK)
        yield cluster.executor, lambda: cluster.slots, own if shared else sweep.out


def _can_write(folder: Path) -> bool:
    """Whether a cache can be kept there; leaves a mark that others can look for."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / _MARK).touch()
    except OSError:
        return False
    return True
