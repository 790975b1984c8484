"""The fingerprint of a bag depends on the bytes of its files, and on nothing else."""

from pathlib import Path

from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.fingerprint import fingerprint


def _write(folder: Path, files: dict[str, bytes]) -> BagPath:
    folder.mkdir()
    for name, content in files.items():
        (folder / name).write_bytes(content)
    return BagPath((folder,))


def test_depends_on_bytes_not_on_names_or_order(tmp_path: Path) -> None:
    first = _write(tmp_path / "first", {"a.mcap": b"one", "b.mcap": b"two"})
    renamed = _write(tmp_path / "renamed", {"z.mcap": b"one", "y.mcap": b"two", "notes.txt": b"x"})
    files = BagPath((tmp_path / "first" / "b.mcap", tmp_path / "first" / "a.mcap"))
    (tmp_path / "renamed" / "folder.mcap").mkdir()
    changed = _write(tmp_path / "changed", {"a.mcap": b"one", "b.mcap": b"twO"})
    assert fingerprint(first) == fingerprint(renamed) == fingerprint(files)
    assert fingerprint(changed) != fingerprint(first)


def test_includes_write_ahead_log(tmp_path: Path) -> None:
    folder = _write(tmp_path / "bag", {"a.db3": b"database", "a.db3-wal": b"log"})
    file = BagPath((tmp_path / "bag" / "a.db3",))
    before = fingerprint(file)
    assert before == fingerprint(folder)
    (tmp_path / "bag" / "a.db3-wal").unlink()
    assert fingerprint(file) != before
