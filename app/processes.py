"""How worker processes are made."""

import multiprocessing as mp
import sys
from multiprocessing import forkserver
from multiprocessing.context import ForkServerContext, SpawnContext


def process_context() -> ForkServerContext | SpawnContext:
    """Workers fork from a server that has loaded what they need, where the system can: that takes two seconds each.

    Nothing forks from the run's own process, whose threads a fork would not survive.
    """
    if sys.platform != "linux":
        return mp.get_context("spawn")
    context = mp.get_context("forkserver")
    context.set_forkserver_preload(["algorithms.odometry", "app.warm_up"])
    return context


def start_server() -> None:
    """Let the workers' server import what it needs while this process still imports what itself needs."""
    if isinstance(process_context(), ForkServerContext):
        forkserver.ensure_running()
