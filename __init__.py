"""Furniture-free maps of buildings from 3-D lidars.

    import ffmap

    scan = ffmap.label_scan(points, ring)            # one array, with the reason of each label
    run = ffmap.map_building("drive.bag", out="runs/a")   # what 'ffmap run' writes
    run = ffmap.open_run("runs/a")                   # labels, walls, doors, rooms, figures
    scan.log(rr)                                     # into a recording of one's own

docs/examples has whole scripts.
"""

import os
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ffmap.algorithms.base.labels import Label as Label
    from ffmap.app.library import LabelledArray as LabelledArray
    from ffmap.app.library import OpenedRun as OpenedRun
    from ffmap.app.library import label_scan as label_scan
    from ffmap.app.library import map_building as map_building
    from ffmap.app.library import open_run as open_run
    from ffmap.app.library import read_scans as read_scans
    from ffmap.loaders.errors import InputError as InputError

_HOME = {"Label": "ffmap.algorithms.base.labels", "InputError": "ffmap.loaders.errors"}
_NAMES = ("LabelledArray", "OpenedRun", "label_scan", "map_building", "open_run", "read_scans")
__all__ = [*_HOME, *_NAMES]


def __getattr__(name: str) -> Any:  # noqa: ANN401 - of a module
    """Import at first use: commands start without the rest."""
    if name not in __all__:
        raise AttributeError(f"module 'ffmap' has no attribute {name!r}")
    from ffmap.app.compiled_code import compiled_code

    os.environ.update(compiled_code())
    return getattr(import_module(_HOME.get(name, "ffmap.app.library")), name)


def __dir__() -> list[str]:
    return sorted(__all__)
