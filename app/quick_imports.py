"""Importing without Python's collector of cycles, which would go over all that was imported before, many times, for nothing."""

import atexit
import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quick_imports() -> Iterator[None]:
    """Let the collector rest, and not look at what was made meanwhile before the process ends: modules stay until then."""
    gc.disable()
    atexit.register(gc.unfreeze)
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
