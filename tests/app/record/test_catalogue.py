"""Runs asked of Rerun's catalogue: what is found, in which order, and what is told of runs that cannot be."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import rerun as rr
from rerun.catalog import DatasetEntry

from ffmap.app.commands import runs as runs_command
from ffmap.app.record.catalogue import runs as catalogue
from ffmap.app.record.catalogue.runs import Query, ask, find_runs
from ffmap.app.record.catalogue.server import CatalogueServer
from ffmap.app.record.stream import send_properties
from ffmap.blueprints import entities
from ffmap.loaders.errors import InputError
from tests.program import FFMAP

F1 = {"a": 0.90, "b": 0.99, "c": 0.95, "d": 0.80}


def write(path: Path, recording_id: str, properties: dict[str, dict[str, Any]]) -> None:
    with rr.RecordingStream(entities.APPLICATION_ID, recording_id=recording_id) as stream:
        stream.save(path)
        for name, values in properties.items():
            send_properties(stream, name, values)
        stream.log("/world", rr.TextLog("something"), static=True)


def make_run(folder: Path, f1: float, similarity_m: float, seconds: float, evaluated: bool = True) -> Path:
    folder.mkdir(parents=True)
    recording_id = f"id of {folder.name}"
    (folder / "run.json").write_text(json.dumps({"recording_id": recording_id, "outcome": "complete"}))
    write(
        folder / "recording.rrd",
        recording_id,
        {
            "settings": {"seed": 0, "wall_planes": {"similarity_m": similarity_m}},
            "run": {"bag": {"path": f"/data/{'x' if f1 < 0.9 else 'y'}.bag"}, "settings_hash": folder.name},
            "result": {"timings_s": {"total": seconds}, "counts": {"doors": 4, "walls": 10}, "outcome": "complete"},
        },
    )
    if evaluated:
        metrics = {"area": {"wall": {"f1": f1}, "door": {"f1": 0.5}}, "doors": {"invented": 1 - f1}}
        write(folder / "evaluation.rrd", recording_id, {"metrics": metrics})
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("runs")
    for i, (name, f1) in enumerate(F1.items()):
        make_run(root / ("sweep" if i % 2 else "") / name, f1, 0.02 + 0.01 * (i % 3), 10.0 - i)
    make_run(root / "unknown", 0.0, 0.02, 3.0, evaluated=False)
    (root / "latest").symlink_to(root / "a", target_is_directory=True)
    return root


def found(folder: Path, **query: Any) -> list[str]:
    with catalogue.serve(find_runs(folder)) as served:
        return [Path(run).name for run in ask(served.dataset, Query(**query)).table.column("run").to_pylist()]


def test_every_run_is_found_once_with_all_it_carries(folder: Path) -> None:
    with catalogue.serve(find_runs(folder)) as served:
        assert not served.left_out
        assert "127.0.0.1" in served.url
        answer = ask(served.dataset, Query())
    rows = {Path(row["run"]).name: row for row in answer.table.to_pylist()}
    assert sorted(rows) == ["a", "b", "c", "d", "unknown"]
    for name, f1 in F1.items():
        assert rows[name]["wall_f1"] == f1
        assert rows[name]["doors"] == 4
    assert rows["b"]["wall_planes.similarity_m"] == 0.03
    assert rows["a"]["seconds"] == 10.0
    assert rows["unknown"]["wall_f1"] is None
    assert rows["b"]["run"] == str(folder / "sweep" / "b")
    assert answer.differing == ["wall_planes.similarity_m"]


@pytest.mark.parametrize(
    ("where", "names"),
    [
        ("wall_f1 > 0.94", {"b", "c"}),
        ("wall_f1 > 0.85 and seconds < 9.5", {"b", "c"}),
        ("wall_planes.similarity_m = 0.02", {"a", "d", "unknown"}),
        ("wall_planes_similarity_m > 0.025 and not doors_invented > 0.03", {"b"}),
        ("bag_path like '%/x.bag'", {"d", "unknown"}),
        ("wall_f1 is null", {"unknown"}),
        ("wall_f1 > 2", set()),
    ],
)
def test_where(folder: Path, where: str, names: set[str]) -> None:
    assert set(found(folder, where=where)) == names


def test_better_runs_come_first(folder: Path) -> None:
    assert found(folder, sort="wall_f1") == ["b", "c", "a", "d", "unknown"]
    assert found(folder, sort="doors_invented") == ["b", "c", "a", "d", "unknown"]
    assert found(folder, sort="seconds") == ["unknown", "d", "c", "b", "a"]
    assert found(folder, sort="seconds", reverse=True) == ["a", "b", "c", "d", "unknown"]
    assert found(folder, sort="wall_planes.similarity_m")[-1] == "c"


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ({"where": "wall_ff > 1"}, ["wall_ff", "'wall_f1'", "seconds"]),
        ({"where": "wall_planes.similarty_m > 1"}, ["'wall_planes.similarity_m'"]),
        ({"where": "wall_f1 >"}, ["wall_f1 >", "SQL"]),
        ({"where": "seconds = 'x"}, ["has no answer"]),
        ({"where": "1/0 = 1"}, ["1/0 = 1", "Divide by zero"]),
        ({"where": "(select count(*) from generate_series(1, 1000000000000)) > 0"}, ["no end"]),
        ({"where": "repeat('a', 2000000000) = 'a'"}, ["too much memory"]),
        ({"where": "+".join(["1"] * 20_000) + " = 1"}, ["nested too deeply"]),
        ({"sort": "speed"}, ["speed", "seconds"]),
    ],
)
def test_a_query_that_makes_no_sense(folder: Path, query: dict[str, str], words: list[str]) -> None:
    with pytest.raises(InputError) as error:
        found(folder, **query)
    assert "\n" not in str(error.value)
    for word in words:
        assert word in str(error.value)


def test_what_cannot_be_queried_is_told_and_the_rest_is_found(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "runs"
    shutil.copytree(folder, root, symlinks=True)
    shutil.copytree(root / "a", root / "copy")
    cut = root / "sweep" / "b" / "recording.rrd"
    cut.write_bytes(cut.read_bytes()[:-300])
    killed = root / "c"
    (killed / "recording.rrd").write_bytes((killed / "recording.rrd").read_bytes()[:-300])
    (killed / "run.json").write_text(json.dumps({"recording_id": "id of c", "outcome": "running"}))
    (root / "unknown" / "run.json").write_text("{")
    runs_command.runs(str(root), Query(), None, None)
    told = capsys.readouterr()
    assert "2 runs in" in told.out
    reasons = dict(line.removeprefix("not in the table: ").split(": ", 1) for line in told.err.strip().splitlines())
    names = {Path(place).name: reason for place, reason in reasons.items()}
    assert sorted(names) == ["b", "c", "copy", "run.json"]
    assert "damaged" in names["b"]
    assert f"ffmap run --resume {killed}" in names["c"]
    assert "copy" in names["copy"]
    assert "no valid JSON" in names["run.json"]


def test_runs_without_a_recording_are_listed(folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        shutil.copytree(next(folder.rglob(name)), tmp_path / "öd und leer" / name)
    bare = tmp_path / "öd und leer" / "b"
    for file in ("recording.rrd", "evaluation.rrd"):
        (bare / file).unlink()
    record = {
        "recording_id": "id of b",
        "outcome": "complete",
        "settings": {"seed": 0, "wall_planes": {"similarity_m": 0.07}},
        "counts": {"doors": 3, "walls": 9},
        "timings_s": {"total": 5.0},
    }
    (bare / "run.json").write_text(json.dumps(record))
    (bare / "metrics.json").write_text(json.dumps({"area": {"wall": {"f1": 0.42}}}))
    with catalogue.serve(find_runs(tmp_path)) as served:
        assert not served.left_out
        rows = {row["run"]: row for row in ask(served.dataset, Query(where="wall_f1 < 0.5")).table.to_pylist()}
    assert list(rows) == [str(bare)]
    expected = {"outcome": "complete", "doors": 3, "seconds": 5.0, "wall_planes.similarity_m": 0.07, "wall_f1": 0.42}
    assert {name: rows[str(bare)][name] for name in expected} == expected


def test_runs_are_registered_at_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[int] = []
    register = catalogue.DatasetEntry.register

    def counted(self: Any, files: list[str], **options: Any) -> Any:
        calls.append(len(files))
        return register(self, files, **options)

    monkeypatch.setattr(catalogue.DatasetEntry, "register", counted)
    with catalogue.serve(find_runs(folder)):
        assert calls == [5, 4]


def test_figures_that_come_later_are_taken(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", 0.9, 0.02, 3.0)
    figures = (run / "evaluation.rrd").read_bytes()
    (run / "evaluation.rrd").unlink()
    with catalogue.serve([run]) as served:
        assert "wall_f1" not in ask(served.dataset, Query()).table.column_names
        (run / "evaluation.rrd").write_bytes(figures[:-300])
        served.add([])
        assert "ffmap evaluate" in served.left_out[run]
        (run / "evaluation.rrd").write_bytes(figures)
        served.add([])
        assert ask(served.dataset, Query()).table.column("wall_f1").to_pylist() == [0.9]


def test_a_copy_stands_in_for_a_damaged_run(tmp_path: Path) -> None:
    run = make_run(tmp_path / "a", 0.9, 0.02, 3.0)
    shutil.copytree(run, tmp_path / "b")
    (run / "recording.rrd").write_bytes((run / "recording.rrd").read_bytes()[:-300])
    with catalogue.serve(find_runs(tmp_path)) as served:
        assert list(served.taken.values()) == [tmp_path / "b"]
        assert "damaged" in served.left_out[run]
        assert ask(served.dataset, Query()).table.column("wall_f1").to_pylist() == [0.9]


def test_no_runs_at_all(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no runs"):
        find_runs(tmp_path)
    with pytest.raises(InputError, match="no folder"):
        find_runs(tmp_path / "nothing")
    make_run(tmp_path / "only", 0.9, 0.1, 1.0)
    (tmp_path / "only" / "recording.rrd").write_text("no recording")
    with pytest.raises(InputError, match="queried"):
        runs_command.runs(str(tmp_path), Query(), None, None)


def test_columns_are_chosen(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs_command.runs(str(folder), Query(sort="wall_f1"), "wall_planes.similarity_m,doors", None)
    table = capsys.readouterr().out
    assert "doors" in table
    assert "wall_f1" not in table
    runs_command.runs(str(folder), Query(), "all", None)
    assert "door_f1\n" in capsys.readouterr().out
    with pytest.raises(InputError, match="'doors'"):
        runs_command.runs(str(folder), Query(), "dors", None)


@pytest.mark.parametrize("width", [80, 120, 200])
def test_the_table_fits_the_terminal(
    width: int, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for i, name in enumerate(("drive-20261123-024400-1a2b3c4d", "drive-20261123-031500-5e6f7a8b")):
        run = make_run(tmp_path / name, 0.9, 0.02, 3.0)
        settings = {
            "doors": {"lines_min": i, "recess_min_m": 0.02 + i, "width_min_m": 0.6 + i},
            "vertical_structures": {"slope_max": 0.1 + i, "points_min": 10 + i},
            "wall_planes": {"similarity_m": 0.04 + i},
            "seed": i,
        }
        properties = {"settings": settings, "result": {"timings_s": {"total": 5.0 + i}, "counts": {"doors": 3}}}
        write(run / "recording.rrd", f"id of {name}", properties)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    runs_command.runs(str(tmp_path), Query(), None, None)
    said = re.sub(r"\x1b\[\d*m", "", capsys.readouterr().out).splitlines()
    headings = [line.strip("┃").split("┃") for line in said if line.startswith("┃")]
    rows = [line for line in said if line.startswith("│")]
    assert max(map(len, [*rows, *(line for line in said if line[0] in "┏┡└")])) <= width
    assert "1a2b3c4d" in "".join(rows)
    assert "…" not in "".join(said)
    # Each setting that differs has a column, or is named among those for which there was no room.
    columns = ["".join(lines).replace(" ", "") for lines in zip(*headings, strict=True)]
    assert {"run", "seconds"} <= set(columns)
    for setting in ("doors.lines_min", "vertical_structures.points_min", "wall_planes.similarity_m", "seed"):
        assert setting in columns or setting in said[-1]


def test_a_piped_table_is_whole(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    runs_command.runs(str(folder), Query(), None, None)
    heading = next(line for line in capsys.readouterr().out.splitlines() if "run" in line)
    assert {"wall_planes.similarity_m", "wall_f1", "doors_invented"} <= {name.strip() for name in heading.split("┃")}


def test_a_server_answers_the_same_takes_new_runs_and_ends_cleanly(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "runs"
    shutil.copytree(folder, root, symlinks=True)
    process = subprocess.Popen(
        [*FFMAP, "serve", str(root), "--port", "0"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert first.startswith("5 runs of"), first
        url = first.split()[-1]
        assert url.startswith("rerun+http://127.0.0.1:")
        query = Query(where="wall_f1 > 0.85", sort="wall_f1")
        runs_command.runs(url, query, "wall_f1", None)
        remote = capsys.readouterr().out
        runs_command.runs(str(root), query, "wall_f1", None)
        here = capsys.readouterr().out

        def rows(text: str) -> list[tuple[str, str]]:
            lines = [line.strip("│ ").split("│") for line in text.splitlines() if line.startswith("│")]
            return [(Path(run.strip()).name, value.strip()) for run, value in lines]

        assert rows(remote) == rows(here) == [("b", "0.99"), ("c", "0.95"), ("a", "0.9")]
        with pytest.raises(InputError, match="runs"):
            runs_command.runs(url, query, None, "other")
        # There at once: a server that looks between its files would add the figures later.
        make_run(tmp_path / "new", 0.999, 0.02, 1.0).rename(root / "new")
        while not (line := process.stdout.readline()).startswith("added"):
            assert line
        assert line.strip().endswith("new")
        runs_command.runs(url, query, "wall_f1", None)
        assert rows(capsys.readouterr().out)[0] == ("new", "0.999")
        layouts = catalogue.connect(url, None).blueprints()
        assert len(layouts) == 1
    finally:
        process.send_signal(signal.SIGINT)
        started = time.monotonic()
        out, err = process.communicate(timeout=30)
    assert process.returncode == 0, err
    assert out.endswith("ended\n")
    assert "Traceback" not in err
    assert time.monotonic() - started < 20
    with pytest.raises(InputError, match="ffmap serve"):
        catalogue.connect(url, None)


def test_asking_for_runs_does_not_wait_for_the_method_to_load() -> None:
    code = "import sys, ffmap.app.commands.runs; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_damaged_recording_that_rerun_takes_does_not_cost_the_list_of_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("a", "b", "c"):
        make_run(tmp_path / name, 0.9, 0.02, 5.0)
    file = tmp_path / "b" / "recording.rrd"
    content = bytearray(file.read_bytes())
    # Within the compressed properties, which are read only when a list of runs is asked for.
    middle = content.index(b"property:", len(content) // 4) // 2
    content[middle : middle + 200] = b"\xff" * 200
    file.write_bytes(content)
    runs_command.runs(str(tmp_path), Query(), None, None)
    told = capsys.readouterr()
    assert "2 runs in" in told.out
    assert f"{tmp_path / 'b'}: recording.rrd is damaged" in told.err


def test_a_server_that_ends_leaves_nothing_among_the_temporary_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # the server is a process of its own, which reads it anew
    with closing(CatalogueServer()):
        assert list(tmp_path.iterdir())
    assert not list(tmp_path.iterdir())


def test_a_recording_that_ends_the_server_costs_none_of_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = [make_run(tmp_path / name, 0.9, 0.02, 5.0) for name in ("a", "b", "c", "d")]
    servers: list[CatalogueServer] = []
    monkeypatch.setattr(catalogue, "CatalogueServer", lambda: servers.append(CatalogueServer()) or servers[0])
    register = DatasetEntry.register

    def end_at_c(self: DatasetEntry, files: list[str], **options: Any) -> Any:
        if any("/c/" in file for file in files):
            os.kill(servers[0]._process.pid, signal.SIGABRT)
            servers[0]._process.wait()  # else it may answer before it ends, and the next one is blamed
        return register(self, files, **options)

    monkeypatch.setattr(DatasetEntry, "register", end_at_c)
    with catalogue.serve(runs[:2]) as served:
        url = served.url
        served.add(runs[2:])
        assert served.url == url
        assert [folder.name for folder in served.taken.values()] == ["a", "b", "d"]
        assert list(served.left_out) == [runs[2]]
        answer = ask(served.dataset, Query())
        assert sorted(answer.table.column("wall_f1").to_pylist()) == [0.9] * 3
