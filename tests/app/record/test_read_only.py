"""Through the door of 'ffmap serve' a catalogue can be read, by Rerun's own clients, and not be changed."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import grpc
import pytest
from rerun.catalog import CatalogClient, DatasetEntry

from ffmap.app.commands import runs as runs_command
from ffmap.app.record.catalogue import runs as catalogue
from ffmap.app.record.catalogue.read_only import READING, read_only
from ffmap.app.record.catalogue.runs import Catalogue, Query
from ffmap.loaders.errors import InputError
from tests.app.record.test_catalogue import make_run


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Catalogue, str]]:
    root = tmp_path_factory.mktemp("runs")
    runs = [make_run(root / name, 0.9, 0.02, 5.0) for name in ("a", "b")]
    with catalogue.serve(runs) as served, read_only(served.url, "127.0.0.1", 0) as url:
        yield served, url


def test_runs_are_asked_for_through_it(served: tuple[Catalogue, str], capsys: pytest.CaptureFixture[str]) -> None:
    runs_command.runs(served[1], Query(where="wall_f1 > 0.5", sort="seconds"), "wall_f1", None)
    assert "2 runs in" in capsys.readouterr().out


def test_recordings_are_read_through_it(served: tuple[Catalogue, str]) -> None:
    dataset = CatalogClient(served[1]).get_dataset(catalogue.DATASET)
    assert sorted(dataset.segment_ids()) == ["id of a", "id of b"]
    assert dataset.reader(index=None).to_arrow_table().num_rows == 2
    own = served[0].dataset
    assert dataset.reader(index=None).to_arrow_table() == own.reader(index=None).to_arrow_table()


CHANGES: dict[str, Callable[[CatalogClient, DatasetEntry, Path], Any]] = {
    "register a file": lambda _, runs, path: list(runs.register([path.as_uri()], layer_name="x").iter_results()),
    "register a folder": lambda _, runs, path: list(runs.register_prefix(path.parent.as_uri()).iter_results()),
    "register a layout": lambda _, runs, path: runs.register_blueprint(path.as_uri()),
    "delete the list": lambda _, runs, __: runs.delete(),
    "name it otherwise": lambda _, runs, __: runs.set_name("other"),
    "make another": lambda client, _, __: client.create_dataset("other"),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_nothing_is_changed_through_it(
    change: Callable[[CatalogClient, DatasetEntry, Path], Any], served: tuple[Catalogue, str]
) -> None:
    client = CatalogClient(served[1])
    file = next(iter(served[0].taken.values())) / "recording.rrd"
    with pytest.raises(PermissionError, match="can only be read"):
        change(client, client.get_dataset(catalogue.DATASET), file)
    assert client.dataset_names() == [catalogue.DATASET]
    assert len(served[0].dataset.segment_ids()) == 2


@pytest.mark.parametrize(
    "method",
    [
        *(
            "RegisterWithDataset",
            "UnregisterFromDataset",
            "RegisterTable",
            "WriteTable",
            "CreateTableEntry",
            "DeleteEntry",
        ),
        *("SetSegmentProperties", "DoMaintenance", "GetWriteAccessGrant", "DoBandwidthTest", "NotKnown"),
    ],
)
def test_what_is_not_named_is_refused(method: str, served: tuple[Catalogue, str]) -> None:
    assert method not in READING
    with grpc.insecure_channel(served[1].partition("://")[2]) as channel:
        for service in ("rerun.cloud.v1alpha1.RerunCloudService", "other.Service"):
            with pytest.raises(grpc.RpcError) as caught:
                channel.unary_unary(f"/{service}/{method}")(b"", timeout=10)
            assert caught.value.code() == grpc.StatusCode.PERMISSION_DENIED


def test_an_error_of_the_server_comes_through(served: tuple[Catalogue, str]) -> None:
    with pytest.raises(LookupError):
        CatalogClient(served[1]).get_dataset("nothing")


def test_an_address_that_cannot_be_had_is_told(served: tuple[Catalogue, str]) -> None:
    taken = int(served[1].rpartition(":")[2])
    for host, port in (("127.0.0.1", taken), ("192.0.2.1", 0), ("no address", 0)):
        with pytest.raises(InputError, match="--port"), read_only(served[0].url, host, port):
            pass
