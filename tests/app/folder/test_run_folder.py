"""Replacing a run: nothing is removed that no run wrote."""

import json
from pathlib import Path

import pytest

from ffmap.app.folder import names
from ffmap.app.folder.names import LABELLED_FOLDER, RUN_JSON
from ffmap.app.folder.record import PROGRAM, RunRecord, write_record
from ffmap.app.folder.run_folder import clear, create, point_latest_at
from ffmap.loaders.errors import InputError

EARLIER = (
    *("recording.rrd", "cloud.ply", "map.pgm", "cloud.ply.part", "spool/00000.arrow"),
    *("labelled/metadata.yaml", "labelled/labelled_0.mcap"),
)
USERS = (
    *("notes.txt", "figures/a.png", "map_of_mine.pgm"),
    *("labelled/mine.txt", "labelled/mine.mcap", "labelled/cuts/a.mcap"),
)


def write_run(folder: Path) -> None:
    folder.mkdir()
    write_record(folder, RunRecord(program=PROGRAM, outcome="complete"))


@pytest.fixture
def home(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    write_run(folder)
    for name in (*EARLIER, *USERS):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(name)
    return folder


def contents(folder: Path) -> set[str]:
    found = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    return found - {RUN_JSON}


def test_what_runs_write_is_removed_and_nothing_else(home: Path) -> None:
    create(home, overwrite=True)
    assert contents(home) == {*EARLIER, *USERS}
    clear(home)
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
def test_a_run_is_not_replaced_by_one_that_reads_it(name: str, home: Path, tmp_path: Path) -> None:
    link = tmp_path / "link"
    link.symlink_to(home)
    for read in (home / name, link / name):
        with pytest.raises(InputError, match="is an input, and belongs to the run"):
            create(home, overwrite=True, inputs=[read])
    create(home, overwrite=True, inputs=[home / "notes.txt", tmp_path / "drive.bag"])


def test_latest_points_at_the_newest_run_and_no_other_link_is_lost(home: Path) -> None:
    latest, newer = home.parent / "latest", home.parent / "newer"
    point_latest_at(home)
    write_run(newer)
    point_latest_at(newer)
    assert latest.readlink() == Path("newer")
    latest.unlink()
    (home.parent / "thesis").mkdir()
    latest.symlink_to("thesis")
    point_latest_at(newer)
    assert latest.readlink() == Path("thesis")


def test_every_file_of_a_run_is_known_by_its_name() -> None:
    constants = {v for n, v in vars(names).items() if n.isupper() and isinstance(v, str)}
    assert constants - {names.SWEEP_TABLE} <= names.file_names()
