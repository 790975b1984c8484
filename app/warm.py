"""python -m ffmap.app.warm: compile what a run needs, by a short run that is thrown away."""

import os
import tempfile
from pathlib import Path

from ffmap.app.compiled_code import compiled_code
from ffmap.app.run.workers import ENVIRONMENT, start_server
from ffmap.app.user_cache import CACHE_VARIABLE

_DRIVE = {"building": "office", "seed": 1, "duration_s": 4.0}


def main() -> None:
    """Simulate a short drive and run on it, with a cache of odometries of its own."""
    os.environ.update(ENVIRONMENT | os.environ | compiled_code())
    start_server()
    # Imported here: Numba reads its folder when it is imported.
    from ffmap.app.commands.run import run
    from ffmap.app.commands.simulate import simulate
    from ffmap.app.setup.options import RunOptions
    from ffmap.app.setup.settings import Settings
    from ffmap.loaders.bag_path import BagPath

    with tempfile.TemporaryDirectory(prefix="ffmap-") as folder:
        os.environ[CACHE_VARIABLE] = folder
        bag = Path(folder) / "drive.bag"
        simulate(bag, _DRIVE, quiet=True)
        options = RunOptions(workers=os.cpu_count() or 1, quiet=True)
        run(BagPath((bag,)), Settings(), options, out=Path(folder) / "run")


if __name__ == "__main__":
    main()
