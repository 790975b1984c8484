"""rerun-importer-ffmap: shows a bag in the Rerun viewer, `rerun drive.bag`.

The viewer starts every program of such a name with every file that it opens, and reads recordings
from their standard output.
"""

import argparse
import os
import sys
from pathlib import Path

from ffmap.app.compiled_code import compiled_code
from ffmap.loaders.errors import InputError

_NOT_OURS = 66
"""Exit code of an importer that leaves a file to others."""
_KINDS = {".bag", ".mcap", ".db3", ".active"}


def main() -> None:
    """Write the recording of a bag to standard output, or exit with 66."""
    parser = argparse.ArgumentParser(description=__doc__, allow_abbrev=False)
    parser.add_argument("path", type=Path, help="file or folder that may be a bag")
    parser.add_argument("--application-id", default="ffmap")
    parser.add_argument("--recording-id")
    options, _ = parser.parse_known_args()
    path: Path = options.path
    # Before the imports below, because most files that a viewer opens are no bags.
    if path.is_file() and options.application_id == path.parent.name != path.stem:
        # The viewer opened the folder, and goes through the files of the bag that it showed.
        sys.exit(0 if _has_bag(path.parent) else _NOT_OURS)
    if path.suffix not in _KINDS and not _has_bag(path):
        sys.exit(_NOT_OURS)
    os.environ |= compiled_code()
    from ffmap.app.commands.import_bag import import_bag
    from ffmap.loaders.bag import open_bag
    from ffmap.loaders.sensors import cloud_topics

    try:
        with open_bag(path) as bag:
            ours = bool(cloud_topics(bag))
    except InputError:
        ours = False
    if not ours:
        sys.exit(_NOT_OURS)
    try:
        import_bag(path, options.application_id, options.recording_id)
    except InputError as error:
        sys.exit(f"ffmap: {error}")


def _has_bag(folder: Path) -> bool:
    return folder.is_dir() and any(file.suffix in _KINDS for file in folder.iterdir())
