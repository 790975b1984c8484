"""Imported by the workers' server before it forks, with all that workers need.

From here on it ignores Ctrl-C, and so do those that fork from it. While it imports, which takes seconds, it looks whether
the run still lives; afterwards it waits for the run anyway. Nothing else imports it: the run's own process does not ignore
the user.
"""

import os
import signal
import threading


def _end_with(run: int, imported: threading.Event) -> None:
    while not imported.wait(0.1):
        if os.getppid() != run:
            os._exit(1)


signal.signal(signal.SIGINT, signal.SIG_IGN)
_imported = threading.Event()
_watch = threading.Thread(target=_end_with, args=(os.getppid(), _imported))
_watch.start()

try:
    from ffmap.app.quick_imports import quick_imports

    with quick_imports():
        import ffmap.app.run.warm_up  # noqa: F401
finally:
    # No thread is left when it forks, nor waits for what has failed.
    _imported.set()
    _watch.join()
