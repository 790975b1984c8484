"""Importing without Python's collector of cycles, which would go over all that was imported before, many times, for nothing."""

import gc
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def quick_imports() -> Iterator[None]:
    """Let the collector rest, and never look at what was made meanwhile: modules stay until the process ends."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
