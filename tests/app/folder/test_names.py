"""Replacing a run: nothing is removed that no run wrote."""

import json
from pathlib import Path

import pytest

from ffmap.app.folder import names as run_folder
from ffmap.app.folder.names import LABELLED_FOLDER, RUN_JSON, RunFolder, create
from ffmap.loaders.errors import InputError

EARLIER = (
    *("recording.rrd", "cloud.ply", "map.pgm", "cloud.ply.part", "spool/00000.arrow"),
    *("labelled/metadata.yaml", "labelled/labelled_0.mcap"),
)
USERS = (
    *("notes.txt", "figures/a.png", "map_of_mine.pgm"),
    *("labelled/mine.txt", "labelled/mine.mcap", "labelled/cuts/a.mcap"),
)


def write_run(folder: RunFolder, **record: str) -> None:
    folder.path.mkdir(exist_ok=True)
    folder.write_json({"program": run_folder.PROGRAM, "outcome": "complete", **record})


@pytest.fixture
def home(tmp_path: Path) -> RunFolder:
    folder = RunFolder(tmp_path / "run")
    write_run(folder, recording_id="a")
    for name in (*EARLIER, *USERS):
        (folder.path / name).parent.mkdir(exist_ok=True)
        (folder.path / name).write_text(name)
    return folder


def contents(folder: RunFolder) -> set[str]:
    found = {str(p.relative_to(folder.path)) for p in folder.path.rglob("*") if p.is_file()}
    return found - {RUN_JSON}


def test_what_runs_write_is_removed_and_nothing_else(home: RunFolder) -> None:
    folder = create(home.path, overwrite=True)
    assert contents(home) == {*EARLIER, *USERS}
    folder.clear()
    assert contents(home) == set(USERS)


def test_what_no_run_wrote_is_refused(tmp_path: Path) -> None:
    theirs = tmp_path / "theirs"
    theirs.mkdir()
    (theirs / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="has files that are no run"):
        create(theirs, overwrite=True)
    (theirs / RUN_JSON).write_text(json.dumps({"experiment": 1}))
    with pytest.raises(InputError, match="that ffmap did not write"):
        create(theirs, overwrite=True)
    assert sorted(p.name for p in theirs.iterdir()) == [RUN_JSON, "thesis.txt"]


@pytest.mark.parametrize("name", ["cloud.ply", f"{LABELLED_FOLDER}/metadata.yaml", LABELLED_FOLDER])
def test_a_run_is_not_replaced_by_one_that_reads_it(
    name: str, home: RunFolder, tmp_path: Path
) -> None:
    link = tmp_path / "link"
    link.symlink_to(home.path)
    for read in (home.path / name, link / name):
        with pytest.raises(InputError, match="is an input, and belongs to the run"):
            create(home.path, overwrite=True, inputs=[read])
    create(home.path, overwrite=True, inputs=[home.path / "notes.txt", tmp_path / "drive.bag"])


def test_latest_points_at_the_newest_run_and_no_other_link_is_lost(home: RunFolder) -> None:
    latest, newer = home.path.parent / "latest", home.path.parent / "newer"
    run_folder.point_latest_at(home.path)
    write_run(RunFolder(newer))
    run_folder.point_latest_at(newer)
    assert latest.readlink() == Path("newer")
    latest.unlink()
    (home.path.parent / "thesis").mkdir()
    latest.symlink_to("thesis")
    run_folder.point_latest_at(newer)
    assert latest.readlink() == Path("thesis")


def test_every_file_of_a_run_is_known_by_its_name() -> None:
    names = {v for n, v in vars(run_folder).items() if n.isupper() and isinstance(v, str)}
    others = {run_folder.PROGRAM, run_folder.SWEEP_TABLE}
    assert names - others <= run_folder.file_names()


def test_nothing_of_one_run_is_written_to_another_that_took_its_place(home: RunFolder) -> None:
    record = home.read_json()
    run_folder.check_same_run(home, record)
    write_run(home, recording_id="b")
    with pytest.raises(InputError, match="another run has replaced"):
        run_folder.check_same_run(home, record)
