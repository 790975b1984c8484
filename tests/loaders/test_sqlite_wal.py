"""A database whose recorder was killed reads as SQLite reads it, with its -wal, and its folder stays as it is."""

import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import pytest

from ffmap.loaders.bag import open_bag
from tests.loaders.bag_builder import clouds, write_bag

COUNT = 12
Rows = list[tuple[int, bytes]]


def killed(folder: Path, checkpointed: int) -> Path:
    """A folder as a killed recorder leaves it. checkpointed: how many of its messages lie in the database itself."""
    source = next(write_bag(folder / "source_db3", clouds("/a", COUNT, ros_version=2)).glob("*.db3"))
    live, left = folder / "live.db3", folder / "left"
    with closing(sqlite3.connect(source)) as whole, closing(sqlite3.connect(live, isolation_level=None)) as bag:
        bag.execute("PRAGMA journal_mode=WAL")
        bag.execute("PRAGMA wal_autocheckpoint=0")
        tables = whole.execute("SELECT sql, type, name FROM sqlite_master WHERE sql IS NOT NULL").fetchall()
        for sql, _, _ in tables:
            bag.execute(sql)
        for name in (name for _, kind, name in tables if kind == "table"):
            rows = whole.execute(f"SELECT * FROM {name}").fetchall()
            for number, row in enumerate(rows):
                if name == "messages" and number == checkpointed:
                    bag.execute("PRAGMA wal_checkpoint(RESTART)")
                bag.execute(f"INSERT INTO {name} VALUES ({','.join('?' * len(row))})", row)
        left.mkdir()
        for suffix in ("", "-wal"):
            shutil.copy(f"{live}{suffix}", left / f"a.db3{suffix}")
    return left


def by_sqlite(folder: Path) -> Rows:
    copy = shutil.copytree(folder, folder.with_name("copy"))
    with closing(sqlite3.connect(copy / "a.db3")) as bag:
        return bag.execute("SELECT timestamp, data FROM messages ORDER BY timestamp").fetchall()


def by_bag(folder: Path) -> Rows:
    with open_bag(folder) as bag:
        rows = [(raw.log_time_ns, bytes(raw.data)) for raw in bag.messages(["/a"])]
        assert list(bag.heads("/a", 40)) == [(time_ns, data[:40]) for time_ns, data in rows]
        assert bag.topics["/a"].count == len(rows)
    return rows


@pytest.mark.parametrize("checkpointed", [0, 5, COUNT])
@pytest.mark.parametrize("described", [False, True])
def test_messages_in_the_wal_are_read(tmp_path: Path, checkpointed: int, described: bool) -> None:
    left = killed(tmp_path, checkpointed)
    if described:
        text = (tmp_path / "source_db3" / "metadata.yaml").read_text()
        (left / "metadata.yaml").write_text(text.replace("source_db3.db3", "a.db3"))
    before = {path.name: path.read_bytes() for path in left.iterdir()}
    rows = by_bag(left)
    assert {path.name: path.read_bytes() for path in left.iterdir()} == before
    assert len(rows) == COUNT
    assert rows == by_sqlite(left)


@pytest.mark.parametrize("place", [0.6, 0.97])
def test_a_torn_wal_is_read_up_to_its_last_whole_commit(tmp_path: Path, place: float) -> None:
    left = killed(tmp_path, 3)
    wal = left / "a.db3-wal"
    content = bytearray(wal.read_bytes())
    content[int(place * len(content))] ^= 1
    wal.write_bytes(content)
    rows = by_bag(left)
    assert 3 <= len(rows) < COUNT
    assert rows == by_sqlite(left)
