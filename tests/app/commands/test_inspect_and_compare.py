"""`ffmap inspect` and `ffmap compare` on real runs agree with the files of the runs."""

import json
import os
import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from rerun.chunk import RrdReader
from scipy.spatial.transform import Rotation

from ffmap.algorithms.base import transforms
from ffmap.algorithms.base.labels import NO_RETURN, Verdict
from ffmap.algorithms.truth.changes import CLASSES, transitions
from ffmap.app.analysis import ground_truth, inspection
from ffmap.app.analysis.run_labels import read_run_labels
from ffmap.app.commands import compare as compare_command
from ffmap.app.commands import inspect as inspect_command
from ffmap.app.folder.finished_run import open_run
from ffmap.app.folder.labels_file import read_labels
from ffmap.app.folder.run_folder import held, is_held
from ffmap.app.record.errors import VERDICT_COLORS
from ffmap.app.record.read_back import rows
from ffmap.app.run import blocks
from ffmap.blueprints import compare as compare_blueprint
from ffmap.blueprints import entities
from ffmap.blueprints.entities import Fault
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate
from ffmap.loaders.trajectory_file import read_tum, write_tum
from tests.app.run.test_scans import failing
from tests.program import ffmap, ffmap_here

SCANS = 29
SETTINGS = (
    "smoothing.returns=9",
    "wall_planes.similarity_m=0.002",
    "doors.recess_min_m=0.05",
    "relabelling.range_noise_m=0.04",
)
Labels = dict[int, tuple[np.ndarray, np.ndarray]]


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    cache = str(tmp_path_factory.mktemp("cache"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("FFMAP_CACHE", cache)
        patch.setenv("COLUMNS", "200")
        yield dict(os.environ)


@pytest.fixture(scope="module")
def runs(environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The same drive run twice, with the default settings and with three others."""
    folder = tmp_path_factory.mktemp("runs")
    bag = folder / "drive.bag"
    simulate(bag, SimulationSettings(building="small", seed=3, sensor="vlp16", duration_s=3.0))
    found = {}
    for name, settings in (("usual", ()), ("other", SETTINGS)):
        found[name] = folder / name
        sets = [word for setting in settings for word in ("--set", setting)]
        done = ffmap_here(environment, "run", bag, "--out", found[name], *sets, "--quiet")
        assert done.returncode == 0, done.stderr
    return found


@pytest.fixture(scope="module")
def compared(
    runs: dict[str, Path], environment: dict[str, str], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    out = tmp_path_factory.mktemp("compared")
    done = ffmap(environment, "compare", runs["usual"], runs["other"], "--out", out)
    assert done.returncode == 0, done.stderr
    for word in (
        *(setting.partition("=")[0] for setting in SETTINGS),
        "labels changed",
        "wall F1 % ↑",
    ):
        assert word in done.stdout
    assert done.stdout.startswith(f"B ({runs['other']}) is worse than A ({runs['usual']}): wall F1 -")
    (out / "stdout.txt").write_text(done.stdout)
    return out


def labels_of(run: Path) -> Labels:
    """label and label_scan of every cloud by its stamp."""
    rows = read_labels(run / "labels.parquet").values()
    return {row.stamp_ns: (row.label, row.label_scan) for row in rows}


def report(out: Path) -> dict[str, Any]:
    return json.loads((out / "comparison.json").read_text())


def compare(out: Path, *paths: Path) -> dict[str, Any]:
    compare_command.compare(paths, out, scans=True, spawn=False, quiet=True)
    return report(out)


def read_static(path: Path, entity: str, name: str) -> list[float]:
    """A column of an entity that holds for the whole recording."""
    for chunk in RrdReader(path).stream().filter(content=entity):
        if name in (batch := chunk.to_record_batch()).schema.names:
            return list(batch.column(name)[0].as_py())
    return []


def recorded(out: Path, entity: str) -> dict[int, dict[str, Any]]:
    return {row.scan: row.values for row in rows(out / "comparison.rrd", entity)}


# --- compare ---


def test_exactly_the_labels_that_differ_are_found(compared: Path, runs: dict[str, Path]) -> None:
    a, b = labels_of(runs["usual"]), labels_of(runs["other"])
    (found,) = report(compared)["comparisons"]
    changed_points = recorded(compared, f"/changes/{'B'}/points")
    placed = read_run_labels(open_run(runs["usual"]), with_points=True)
    places = {cloud.scan: points for cloud, points in placed}
    wrong_a, wrong_b = (wrong_by_scan(runs[name]) for name in ("usual", "other"))
    for scan, stamp in enumerate(sorted(a)):
        (label_a, scan_a), (label_b, scan_b) = a[stamp], b[stamp]
        differs, valid = label_a != label_b, (label_a != NO_RETURN) | (label_b != NO_RETURN)
        before, after = transitions(label_a, label_b)
        assert found["scans"][scan] == {
            "scan": scan,
            "stamp_ns": stamp,
            "points": np.count_nonzero(valid),
            "changed": np.count_nonzero(differs),
            "changed_label_scan": np.count_nonzero(scan_a != scan_b),
            "became_right": np.count_nonzero(wrong_a[scan] & ~wrong_b[scan]),
            "became_wrong": np.count_nonzero(~wrong_a[scan] & wrong_b[scan]),
        }
        # Which point changed from what to what and where, in the cloud's order.
        values = changed_points[scan]
        np.testing.assert_array_equal(values["before"], before[differs])
        np.testing.assert_array_equal(values["after"], after[differs])
        codes = CLASSES * before.astype(int) + after
        np.testing.assert_array_equal(values["class_ids"], codes[differs])
        np.testing.assert_allclose(values["positions"], places[scan][differs], atol=1e-5)
    changes = found["changes"]
    assert len(found["scans"]) == changes["labels.scans"] == len(a) == SCANS
    assert changes["labels.changed"] == sum(s["changed"] for s in found["scans"]) > 500
    assert changes["labels.changed_scan"] > 1000
    assert sum(found["transitions"].values()) == changes["labels.changed"]
    for kind in ("right", "wrong"):
        judged = sum(scan[f"became_{kind}"] for scan in found["scans"])
        assert judged == sum(counts[kind] for counts in found["became"].values()) > 0
        assert judged == changes[f"labels.became_{kind}"]


def test_what_differs_is_printed_and_in_the_recording(
    compared: Path, runs: dict[str, Path]
) -> None:
    found = report(compared)
    (change,) = found["comparisons"]
    chunks = RrdReader(compared / "comparison.rrd").stream().filter(content=["/changes/B/text"])
    batches = [chunk.to_record_batch() for chunk in chunks]
    text = str([batch.column("TextDocument:text").to_pylist() for batch in batches])
    worst = max(change["scans"], key=lambda scan: scan["changed"])["scan"]
    for shown in (text, (compared / "stdout.txt").read_text()):
        for words in (f"labels {next(iter(change['transitions']))}", "wall faces lost m"):
            assert words in shown
        assert re.search(rf"scan with most changed labels\W+{worst}\b", shown)
    assert found["settings"] == {
        "smoothing.returns": [11, 9],
        "wall_planes.similarity_m": [0.05, 0.002],
        "doors.recess_min_m": [0.022, 0.05],
        "relabelling.range_noise_m": [0.018, 0.04],
    }
    names = ("usual", "other")
    metrics = [json.loads((runs[name] / "metrics.json").read_text()) for name in names]
    assert found["figures"]["wall.f1"] == [own["wall.f1"] for own in metrics]
    assert change["not_compared"] == {}
    assert change["changes"]["trajectory.poses"] == SCANS
    assert change["changes"]["trajectory.max_m"] == 0.0
    files = [json.loads((runs[name] / "doors.geojson").read_text()) for name in names]
    more = len(files[1]["features"]) - len(files[0]["features"])
    assert more == change["changes"]["doors.gained"] - change["changes"]["doors.lost"]


@pytest.mark.skipif(sys.platform == "win32", reason="folders cannot be locked there")
def test_a_run_that_was_killed_is_told_from_one_that_is_running(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    killed = tmp_path / "killed"
    killed.mkdir()
    record = json.loads((runs["other"] / "run.json").read_text())
    (killed / "run.json").write_text(json.dumps(record | {"outcome": "running"}))
    with held(killed):
        assert open_run(killed).outcome == "running"
        found = compare(tmp_path / "out", runs["usual"], killed)
        assert is_held(killed)
    assert "B, killed: is running; what it has is compared" in found["warnings"]
    found = compare(tmp_path / "out", runs["usual"], killed)
    resume = f"('ffmap run --resume {killed}' continues it)"
    assert f"B, killed: is killed {resume}; what it has is compared" in found["warnings"]
    assert [run["outcome"] for run in found["runs"]] == ["complete", "killed"]
    assert not is_held(killed)


def test_points_of_the_bag_lie_where_the_recording_has_them(runs: dict[str, Path]) -> None:
    """But for tenths of a degree by which the recording's scans are turned to the floor."""
    recording = runs["usual"] / "recording.rrd"
    poses = {row.scan: row.values for row in rows(recording, "/scan", "translation")}
    seen = {}
    for row in rows(recording, entities.POINTS, entities.POINT_LABEL_SCAN):
        pose = poses[row.scan]
        T = transforms.from_quaternion(pose["translation"][0], pose["quaternion"][0])
        seen[row.scan] = transforms.apply(T, row.values["positions"].astype(np.float64))
    off_m = []
    for cloud, points in read_run_labels(open_run(runs["usual"]), with_points=True):
        own = points[cloud.label_scan != NO_RETURN]
        off_m.append(np.linalg.norm(own - seen[cloud.scan], axis=1))
    assert np.median(np.concatenate(off_m)) < 0.006
    assert np.quantile(np.concatenate(off_m), 0.95) < 0.02


def test_the_recording_holds_both_runs_below_their_letters(
    compared: Path, runs: dict[str, Path]
) -> None:
    path = compared / "comparison.rrd"
    RrdReader(path).store()  # fails without a footer
    assert len(RrdReader(path).recordings()) == 1
    for letter, name in (("A", "usual"), ("B", "other")):
        recording = runs[name] / "recording.rrd"
        own = {row.scan: row for row in rows(recording, entities.POINTS, "label_scan")}
        below = {row.scan: row for row in rows(path, f"/{letter}{entities.POINTS}", "label_scan")}
        assert own.keys() == below.keys() == set(range(SCANS))
        for scan, row in own.items():
            for column in ("label_scan", "positions"):
                np.testing.assert_array_equal(row.values[column], below[scan].values[column])
    entity_paths = {chunk.entity_path for chunk in RrdReader(path).stream()}
    assert not [p for p in entity_paths if p.startswith("/scan")]
    for layer in ("cubes", "became_right", "became_wrong"):
        assert f"/changes/B/{layer}" in entity_paths


def test_a_run_against_its_copy_differs_nowhere(
    compared: Path, runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copied = tmp_path / "copied"
    shutil.copytree(runs["usual"], copied)
    layout = Mock(wraps=compare_blueprint.build)
    monkeypatch.setattr(compare_blueprint, "build", layout)
    found = compare(tmp_path / "out", runs["usual"], copied, runs["other"])
    same, other = found["comparisons"]
    best, verdict, _ = found["verdict"]
    assert best.startswith(f"Best: A ({runs['usual']}), B ({copied}); no figure differs")
    assert verdict == f"B ({copied}) is as good as A ({runs['usual']}): no final label changed."
    # It opens on what changed most: the third run, not the copy, and there its worst scan.
    worst = max(other["scans"], key=lambda scan: scan["changed"])["scan"]
    assert layout.call_args.args[3:] == (worst, "C", (0, SCANS - 1))
    assert same["transitions"] == {}
    assert same["changes"]["labels.points"] > 100_000
    differing = ("changed", "lost", "gained", "altered", "lost_m", "gained_m", "max_m")
    assert not any(v for k, v in same["changes"].items() if k.rpartition(".")[2] in differing)
    # Two runs with the same recording id are both there, and the third is compared as it is alone.
    recording = RrdReader(tmp_path / "out" / "comparison.rrd")
    entity_paths = {chunk.entity_path for chunk in recording.stream()}
    assert {f"/{letter}{entities.POINTS}" for letter in "ABC"} <= entity_paths
    assert other["changes"] == report(compared)["comparisons"][0]["changes"]


def test_poses_that_differ_are_measured_and_labels_compared_all_the_same(
    compared: Path, runs: dict[str, Path], tmp_path: Path
) -> None:
    """As after another levelling: the second map is turned by a degree, and shifted."""
    moved = tmp_path / "moved"
    shutil.copytree(runs["other"], moved)
    poses = read_tum(moved / "trajectory.tum")
    turn = Rotation.from_euler("yz", [0.3, 1.0], degrees=True)
    turned = poses.moved(transforms.make_transform(turn, [0.1, 0.0, 0.02]))
    write_tum(moved / "trajectory.tum", turned)
    (change,) = compare(tmp_path / "out", runs["usual"], moved)["comparisons"]
    (same,) = report(compared)["comparisons"]
    assert (change["scans"], change["transitions"]) == (same["scans"], same["transitions"])
    distance = np.linalg.norm((turned.T_map_base - poses.T_map_base)[:, :3, 3], axis=1)
    measured = {name: change["changes"][f"trajectory.{name}"] for name in ("mean_m", "max_m")}
    expected = {"mean_m": distance.mean(), "max_m": distance.max()}
    assert measured == pytest.approx(expected, abs=1e-6)
    assert change["changes"]["trajectory.aligned_max_m"] < 1e-6 < 0.1 < measured["mean_m"]
    drawn = recorded(tmp_path / "out", f"/changes/{'B'}/pose_distance_m/in_the_map")
    curve = [drawn[scan]["scalars"][0] for scan in range(SCANS)]
    np.testing.assert_allclose(curve, distance, atol=2e-6)
    # Changed points lie in the first run's map, over which they are shown.
    points = f"/changes/{'B'}/points"
    mine, usual = recorded(tmp_path / "out", points), recorded(compared, points)
    for scan in range(SCANS):
        np.testing.assert_array_equal(mine[scan]["positions"], usual[scan]["positions"])


def test_points_of_another_bag_are_not_taken_for_the_runs(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    """Such as one of the same name, recorded later with another lidar."""
    other = tmp_path / "drive.bag"
    drive = {"building": "small", "seed": 3, "format": "bag", "duration_s": 3.0}
    simulate(other, SimulationSettings.model_validate({**drive, "sensor": "hdl32e"}))
    run = Path(shutil.copytree(runs["usual"], tmp_path / "run"))
    record = json.loads((run / "run.json").read_text())
    record["bag"]["path"] = str(other)
    (run / "run.json").write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"drive.bag: is not the bag that .* was made from"):
        list(read_run_labels(open_run(run), with_points=True))


def test_what_a_run_lacks_is_reported_and_the_rest_compared(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    record = json.loads((runs["other"] / "run.json").read_text())

    def make(name: str, **changed: object) -> Path:
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_text(json.dumps(record | changed))
        return tmp_path / name

    cut = make("cut")
    shutil.copy(runs["other"] / "walls.geojson", cut)
    whole = (runs["other"] / "recording.rrd").read_bytes()
    (cut / "recording.rrd").write_bytes(whole[: int(0.7 * len(whole))])
    found = compare(tmp_path / "out1", runs["usual"], cut)
    assert any("is not a complete Rerun" in warning for warning in found["warnings"])
    (change,) = found["comparisons"]
    assert set(change["not_compared"]) == {"labels", "trajectory", "doors", "grid"}
    assert all("B has no" in why for why in change["not_compared"].values())

    bare = make("bare", outcome="aborted", settings={"gone": {"by_m": 1}})
    (bare / "recording.rrd").write_text("this is no recording")
    found = compare(tmp_path / "out2", bare, runs["usual"])
    for words in ("aborted", "is not a complete Rerun"):
        assert any(words in warning for warning in found["warnings"])
    assert found["settings"]["gone.by_m"] == [1, None]
    assert found["comparisons"][0]["compared"] == []

    foreign = make("foreign", bag={"path": "/elsewhere.bag", "digest": "another"})
    shutil.copy(runs["usual"] / "metrics.json", foreign)
    found = compare(tmp_path / "out3", runs["usual"], foreign)
    reasons = set(found["comparisons"][0]["not_compared"].values())
    assert reasons == {"the runs labelled different bags or topics"}
    assert len(set(found["figures"]["wall.f1"])) == 1
    (foreign / "metrics.json").write_text("[]")
    with pytest.raises(InputError, match=r"metrics\.json: .*no names and values"):
        compare(tmp_path / "out4", runs["usual"], foreign)


def test_mistakes_are_one_line_and_nothing_of_a_run_is_overwritten(
    runs: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    before = {path: path.stat().st_mtime_ns for path in runs["usual"].iterdir()}
    usual, empty = runs["usual"], tmp_path / "empty"
    empty.mkdir()
    done = ffmap_here(environment, "compare", usual, empty)
    assert done.returncode == 2, done.stderr
    assert "empty: is no run folder" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    for paths, out, expected in (
        ((usual,), None, "two run folders"),
        ((usual, tmp_path / "none"), None, "none: no such folder"),
        ((usual, runs["other"]), usual / "recording.rrd", "recording.rrd: is within a run"),
    ):
        with pytest.raises(InputError, match=expected):
            compare_command.compare(paths, out, scans=True, spawn=False, quiet=True)
    assert {path: path.stat().st_mtime_ns for path in runs["usual"].iterdir()} == before


# --- inspect ---


def test_the_building_is_printed_with_its_odds(
    runs: dict[str, Path], environment: dict[str, str]
) -> None:
    done = ffmap_here(environment, "inspect", runs["usual"])
    assert done.returncode == 0, done.stderr
    walls = json.loads((runs["usual"] / "walls.geojson").read_text())["features"]
    table = re.split(r"^Walls *$", done.stdout, flags=re.MULTILINE)[1].splitlines()
    rows = [row.split() for row in table if re.match(r" *\d+ +-?\d+ ", row)]
    assert [int(row[0]) for row in rows[: len(walls)]] == list(range(len(walls)))
    (odds,) = read_static(runs["usual"] / "recording.rrd", f"{entities.WALLS}/000", "odds")
    assert int(rows[0][1]) == round(odds)


def test_a_scan_that_fails_is_named_with_its_reason(
    runs: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    failing_label_scan = failing(blocks.label_scan, {0}, ValueError("no wall"))
    monkeypatch.setattr(blocks, "label_scan", failing_label_scan)
    with pytest.raises(InputError, match=r"--scan 3: was skipped \(ValueError: no wall\)"):
        inspection.label_again(open_run(runs["other"]), 3)


def test_a_scan_is_labelled_again_bit_for_bit(
    runs: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    out = tmp_path / "scan.rrd"
    done = ffmap(
        environment, "inspect", runs["other"], "--scan", "worst", "--line", "3", "--out", out
    )
    assert done.returncode == 0, done.stderr
    assert "have a wrong final label (label), by ground truth" in done.stdout
    assert "equal label_scan in labels.parquet" in done.stdout
    for number in (0, 17, SCANS - 1):
        found = inspection.label_again(open_run(runs["other"]), number)
        assert found.differing == 0
    lines = len(found.labelling.lines)
    documents: dict[int, str] = {}
    strips: dict[int, int] = {}
    for chunk in RrdReader(out).stream().filter(content=["/why/line", "/scan/lines/example"]):
        batch = chunk.to_record_batch()
        if entities.LINE_TIMELINE not in batch.schema.names:
            continue
        for i, line in enumerate(batch.column(entities.LINE_TIMELINE).to_pylist()):
            if chunk.entity_path == "/why/line":
                documents[line] = batch.column("TextDocument:text")[i].as_py()[0]
            else:
                strips[line] = sum(
                    len(strip) for strip in batch.column("LineStrips3D:strips")[i].as_py()
                )
    assert documents.keys() == strips.keys() == set(range(lines))
    assert all(documents[line].startswith(f"# Line {line} ") for line in documents)
    assert set(strips.values()) <= {0, 200}


@pytest.fixture
def not_evaluated(runs: dict[str, Path], tmp_path: Path) -> Path:
    """A run without a recording of single scans, as those of a sweep."""
    folder = tmp_path / "run"
    folder.mkdir()
    for name in ("run.json", "labels.parquet", "trajectory.tum"):
        shutil.copy(runs["other"] / name, folder)
    return folder


@pytest.fixture
def without_truth(not_evaluated: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run whose bag has no ground truth."""
    monkeypatch.setattr(ground_truth, "read_truth", lambda bag: None)
    return not_evaluated


def test_the_truth_of_a_run_of_a_sweep_is_that_of_its_bag(
    runs: dict[str, Path], not_evaluated: Path
) -> None:
    run = open_run(not_evaluated)
    assert inspection.find_worst(run) == inspection.find_worst(open_run(runs["other"]))
    found = inspection.label_again(run, 17)
    assert found.faults is not None
    np.testing.assert_array_equal(found.faults.fault > 0, wrong_by_scan(runs["other"])[17])
    headings, table = inspection.label_counts(found)
    assert headings == ("true class", "final label", "returns", "")
    counted = {row[:2]: int(row[2].replace(",", "")) for row in table}
    assert counted["wall", "wall"] > 1000
    assert sum(counted.values()) == len(found.labelling.label)
    wrong = sum(int(row[2].replace(",", "")) for row in table if row[3] == "wrong")
    assert wrong == np.count_nonzero(found.faults.fault)


def wrong_by_scan(run: Path) -> dict[int, np.ndarray]:
    """Whether each return (n,) of a scan has a wrong label, by evaluation.rrd."""
    right = VERDICT_COLORS[Verdict.RIGHT]
    found = rows(run / "evaluation.rrd", entities.POINTS)
    return {row.scan: row.values[entities.POINT_VERDICT_COLOR] != right for row in found}


def test_the_worst_scan_is_that_with_most_errors_or_most_changed_labels(
    runs: dict[str, Path], without_truth: Path
) -> None:
    share = {scan: np.mean(wrong) for scan, wrong in wrong_by_scan(runs["other"]).items()}
    worst, _ = inspection.find_worst(open_run(runs["other"]))
    assert worst == max(share, key=share.__getitem__)
    relabelled = [
        np.count_nonzero(label != label_scan) / np.count_nonzero(label != NO_RETURN)
        for _, (label, label_scan) in sorted(labels_of(runs["other"]).items())
    ]
    worst, why = inspection.find_worst(open_run(without_truth))
    assert worst == int(np.argmax(relabelled))
    assert "not those of the scan alone" in why


def test_the_worst_scan_opens_at_its_worst_line_and_names_wrong_labels(
    runs: dict[str, Path],
    not_evaluated: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = runs["other"]
    scan, _ = inspection.find_worst(open_run(run))
    wrong = wrong_by_scan(run)[scan]
    labels = labels_of(run)
    label, label_scan = (own[own != NO_RETURN] for own in labels[sorted(labels)[scan]])
    changed = label != label_scan
    written = Mock(wraps=inspect_command.write)
    monkeypatch.setattr(inspect_command, "write", written)
    inspect_command.inspect(run, "worst", None, None, tmp_path / "worst.rrd", spawn=False)
    explained = written.call_args.args[2]
    lines, faults = explained.labelling.lines, explained.faults
    assert faults.by_truth
    np.testing.assert_array_equal(faults.fault == Fault.OF_THE_SCAN, wrong & ~changed)
    np.testing.assert_array_equal(faults.fault == Fault.OF_THE_BUILDING, wrong & changed)
    in_order = wrong[lines.order]
    ends = zip(lines.starts[:-1], lines.starts[1:], strict=True)
    counts = [np.count_nonzero(in_order[start:end]) for start, end in ends]
    assert explained.line == int(np.argmax(counts))
    out = capsys.readouterr().out
    for words in (
        f"The final label (label) of {wrong.sum():,} of {len(wrong):,} returns is wrong",
        f"{(wrong & ~changed).sum():,} with that label by the scan itself (label_scan)",
        f"Most are in line {explained.line} ",
        f"{max(counts):,}.",
    ):
        assert words in out
    changes = inspection.label_again(open_run(run), scan).changes
    counted, also_wrong = (
        sum(int(change[column].replace(",", "")) for change in changes) for column in (0, 1)
    )
    assert (counted, also_wrong) == (changed.sum(), (wrong & changed).sum())
    assert min(counted, also_wrong) > 0
    assert changes[0][0] in out
    assert changes[0][3].split()[-1] in out
    face = next(change for change in changes if change[3] == "wall face")
    assert face[4].endswith(":1")
    # The first table is of labels, the line's of its conditions, with values to turn them.
    assert out.startswith(f"Scan {scan} of other: labels of its returns")
    assert out.index("true class") < out.index("The final label")
    assert "wall_planes.similarity_m=0.002" in out
    assert "Why its returns have their labels by the scan" in out

    monkeypatch.setattr(ground_truth, "read_truth", lambda bag: None)
    # Without truth, what the building changed; a line that the user names precedes the worst.
    inspect_command.inspect(not_evaluated, str(scan), 3, None, tmp_path / "a.rrd", spawn=False)
    explained = written.call_args.args[2]
    assert not explained.faults.by_truth
    np.testing.assert_array_equal(explained.faults.fault == Fault.RELABELLED, changed)
    assert explained.line == 3
    assert "is not the label by the scan itself (label_scan)" in capsys.readouterr().out

    # A run without final labels says that nothing is marked.
    (not_evaluated / "labels.parquet").unlink()
    inspect_command.inspect(not_evaluated, str(scan), None, None, tmp_path / "b.rrd", spawn=False)
    assert written.call_args.args[2].faults is None
    assert "has no final labels (label) of this scan" in capsys.readouterr().out


def test_a_run_that_is_not_this_programs_is_not_passed_off_as_such(
    runs: dict[str, Path], tmp_path: Path
) -> None:
    """The labels of one run with the settings of the other."""
    altered = tmp_path / "altered"
    shutil.copytree(runs["usual"], altered)
    shutil.copy(runs["other"] / "run.json", altered)
    run = open_run(altered)
    usual, other = (labels_of(runs[name]) for name in ("usual", "other"))
    differing = [np.count_nonzero(usual[stamp][1] != other[stamp][1]) for stamp in sorted(usual)]
    worst = int(np.argmax(differing))
    found = inspection.label_again(run, worst)
    assert found.differing == differing[worst] > 0
    assert f"{differing[worst]:,} of" in inspection.agreement(run, found)


def test_what_cannot_be_inspected_is_one_line(
    runs: dict[str, Path], environment: dict[str, str], tmp_path: Path
) -> None:
    done = ffmap_here(environment, "inspect", runs["usual"], "--scan", SCANS)
    assert done.returncode == 2
    assert f"--scan {SCANS}: usual has scans 0 to {SCANS - 1}" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    out = tmp_path / "x.rrd"
    alone = ffmap_here(environment, "inspect", runs["usual"], "--line", 3)
    assert "--line: requires --scan" in alone.stderr
    moved = tmp_path / "moved"
    moved.mkdir()
    record = json.loads((runs["usual"] / "run.json").read_text())
    bag = BagPath((Path(record["bag"]["path"]),))
    (moved / "run.json").write_text(
        json.dumps(record | {"bag": record["bag"] | {"path": str(tmp_path / "gone.bag")}})
    )
    for path, scan, line, wanted in (
        (runs["usual"], "-1", None, "has scans 0 to"),
        (runs["usual"], "five", None, "give a scan's number, or worst"),
        (runs["usual"], "3", 32, "have lines 0 to 31"),
        (tmp_path / "none", "3", None, "no such folder"),
        (tmp_path, "3", None, "is no run folder"),
        (moved, "worst", None, "no labels of single scans"),
        (moved, "3", None, "Pass the bag of the run with --bag"),
    ):
        with pytest.raises(InputError, match=wanted):
            inspect_command.inspect(path, scan, line, None, out, spawn=False)
    with pytest.raises(InputError, match="has no recording of its building"):
        inspect_command.print_building(moved)
    for taken in (runs["usual"] / "recording.rrd", runs["other"] / "recording.rrd"):
        with pytest.raises(InputError, match="belongs to the run"):
            inspect_command.inspect(runs["usual"], "3", None, None, taken, spawn=False)
    assert not out.exists()
    inspect_command.inspect(moved, "3", None, bag, out, spawn=False)
    RrdReader(out).store()  # fails without a footer
