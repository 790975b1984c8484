"""Which rows of a table an SQL condition is true of, found in a process of its own.

Conditions come from users, and an engine that carries them out can be kept busy without end, fill the memory, or be brought
down: that ends this process alone.
"""

import json
import os
import signal
import subprocess
import sys

import psutil
import pyarrow as pa  # type: ignore[import-untyped]

_SECONDS_MAX = 4
"""Of the processor; runs are asked for what they say of themselves, which takes milliseconds."""
_WAIT_S = 60.0
"""Until the process is ended where nothing bounds its seconds of the processor, however busy the machine is."""
_MEMORY_MAX = 1 << 30
_CONDITION = b"condition"
_ROW = "ffmap_row"


_ENDLESS = f"it has no end, or takes longer than {_SECONDS_MAX} s"


class ConditionError(Exception):
    """Why a condition has no answer, in one line or as the engine says it."""


def rows_where(table: pa.Table, condition: str) -> list[int]:
    """Numbers of the rows of which `condition` (SQL on the table's columns) is true, in their order.

    Raises ConditionError where it cannot be understood or carried out, or takes too long.
    """
    numbered = table.append_column(_ROW, pa.array(range(len(table)), pa.int64()))
    sink = pa.BufferOutputStream()
    with pa.ipc.new_stream(sink, (asked := numbered.replace_schema_metadata({_CONDITION: condition})).schema) as stream:
        stream.write_table(asked)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", "from ffmap.app.record.catalogue.condition import main; main()"],
            input=sink.getvalue().to_pybytes(),
            capture_output=True,
            env={**os.environ, "TOKIO_WORKER_THREADS": "1"},
            timeout=_WAIT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise ConditionError(_ENDLESS) from None
    if sys.platform != "win32" and -done.returncode in (signal.SIGXCPU, signal.SIGKILL):
        raise ConditionError(_ENDLESS)
    if done.returncode:
        raise ConditionError("it takes too much memory, or is nested too deeply")
    answer = json.loads(done.stdout)
    if "error" in answer:
        raise ConditionError(answer["error"])
    return sorted(answer["rows"])


def main() -> None:
    """Answer one condition: the table on standard input, row numbers or an error as JSON on standard output."""
    import datafusion  # here: whoever asks needs none of it

    table = pa.ipc.open_stream(sys.stdin.buffer.read()).read_all()
    runs = datafusion.SessionContext().from_arrow(table)
    _bound_process()
    try:
        found = runs.filter(table.schema.metadata[_CONDITION].decode())
        answer: dict[str, object] = {"rows": found.select(_ROW).to_arrow_table().column(_ROW).to_pylist()}
    except Exception as error:  # whatever the engine stumbles over is told to whoever asked
        answer = {"error": str(error)}
    sys.stdout.write(json.dumps(answer))


def _bound_process() -> None:
    """End this process where it takes too long, or much more memory than the libraries reserved as they were loaded."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CPU, (_SECONDS_MAX, _SECONDS_MAX + 1))
    if sys.platform == "linux":
        most = psutil.Process().memory_info().data + _MEMORY_MAX
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
