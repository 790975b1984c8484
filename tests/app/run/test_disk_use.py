"""What a run says it will write, beside what it wrote; and what it says where there is no room for it."""

import shutil
from collections import namedtuple
from pathlib import Path

import pytest

from ffmap.app.commands import run as run_command
from ffmap.app.folder.names import RunFolder
from ffmap.app.run import disk_use
from ffmap.app.run.disk_use import check_disk, estimate
from ffmap.app.run.start import Arguments
from ffmap.app.setup.inputs import InputOptions, Inputs, find_inputs
from ffmap.app.setup.outputs import RUN_OUTPUTS, Detail, Output
from ffmap.loaders.bag_path import BagPath
from ffmap.loaders.errors import InputError
from ffmap.loaders.simulator import SimulationSettings, simulate

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "drive.bag"
    values = {"building": "small", "seed": 3, "sensor": "vlp16", "duration_s": 3.0}
    simulate(path, SimulationSettings.model_validate(values))
    return path


@pytest.fixture(scope="module")
def inputs(bag: Path) -> Inputs:
    return find_inputs(bag, InputOptions())


def free(monkeypatch: pytest.MonkeyPatch, count: float) -> None:
    monkeypatch.setattr(disk_use.shutil, "disk_usage", lambda _: Usage(10**12, 0, int(count)))


@pytest.mark.parametrize("detail", list(Detail))
def test_what_is_said_is_what_is_written(
    detail: Detail, bag: Path, inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FFMAP_CACHE", str(bag.parent))
    use = estimate(inputs, RUN_OUTPUTS, detail)
    assert use is not None
    out, spooled = tmp_path / "run", []
    remove = shutil.rmtree

    def weigh(path: Path, **options: bool) -> None:
        spooled.extend(file.stat().st_size for file in Path(path).rglob("*"))
        remove(path, **options)

    monkeypatch.setattr("ffmap.app.run.stages.shutil.rmtree", weigh)
    arguments = Arguments(bag=BagPath((bag,)), out=out, detail=detail.value, evaluate=False, quiet=True, workers=1)
    run_command.run(arguments, None)
    written = {file.name: file.stat().st_size for file in out.iterdir() if file.is_file()}
    assert use.kept[Output.LABELLED] == pytest.approx(written["labelled.bag"], rel=0.02)
    # Short drives have less of the map and more of what is told once than those that it was measured on.
    assert use.kept[Output.RECORDING] == pytest.approx(written["recording.rrd"], rel=0.25, abs=1e6)
    assert use.total == pytest.approx(sum(written.values()), rel=0.1)
    most = sum(written.values()) + sum(spooled) + written["recording.rrd"]
    assert use.most == pytest.approx(most, rel=0.2)


def test_outputs_and_detail_make_it_less(inputs: Inputs) -> None:
    sizes = [
        use.most
        for use in (
            estimate(inputs, RUN_OUTPUTS, Detail.LINES),
            estimate(inputs, RUN_OUTPUTS, Detail.SCANS),
            estimate(inputs, RUN_OUTPUTS, Detail.MAP),
            estimate(inputs, (Output.MAPS,), Detail.MAP),
        )
        if use is not None
    ]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 4


def test_a_run_that_does_not_fit_is_refused_before_anything_is_written(
    bag: Path, inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use = estimate(inputs, RUN_OUTPUTS, Detail.LINES)
    assert use is not None
    free(monkeypatch, 0.5 * use.most)
    out = tmp_path / "new" / "run"
    with pytest.raises(InputError, match="does not fit") as error:
        run_command.run(Arguments(bag=BagPath((bag,)), out=out, quiet=True, workers=1), None)
    assert "\n" not in str(error.value)
    for words in (str(out), "labelled bag", "are free", "--outputs recording,cloud,maps,plan,geojson"):
        assert words in str(error.value)
    assert not out.parent.exists()
    # What a run has written that is gone on with need not be written again.
    folder = RunFolder(tmp_path / "begun")
    folder.path.mkdir()
    (folder.path / "labelled.bag.part").write_bytes(bytes(int(0.5 * use.most)))
    assert check_disk(inputs, folder.path, RUN_OUTPUTS, Detail.LINES, folder).warnings


def test_what_may_not_fit_is_warned_of(inputs: Inputs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    use = estimate(inputs, RUN_OUTPUTS, Detail.LINES)
    assert use is not None
    free(monkeypatch, 1.1 * use.most)
    check = check_disk(inputs, tmp_path, RUN_OUTPUTS, Detail.LINES, None)
    assert "may become full" in check.warnings[0]
    free(monkeypatch, 1.5 * use.most)
    check = check_disk(inputs, tmp_path, RUN_OUTPUTS, Detail.LINES, None)
    assert not check.warnings
    assert check.said.startswith("disk: about ")
    without = tuple(output for output in RUN_OUTPUTS if output is not Output.LABELLED)
    assert "--detail scans" in check_disk(inputs, tmp_path, without, Detail.LINES, None).said
    assert "--detail map" in check_disk(inputs, tmp_path, without, Detail.SCANS, None).said
    assert check_disk(inputs, tmp_path, (Output.MAPS,), Detail.MAP, None).said.endswith("are free there")
