"""A door to a Rerun catalogue through which others can read, and nothing else.

Rerun's server takes every call from whoever reaches it: registering files of this machine, writing, deleting. It has neither
tokens nor a read-only mode. So it listens on a loopback port of its own, and what others connect to passes on, byte by byte,
only the calls named here.
"""

import asyncio
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager

import grpc
import grpc.aio

from ffmap.loaders.errors import InputError

_SERVICE = "/rerun.cloud.v1alpha1.RerunCloudService/"
READING = frozenset(
    {
        *("Version", "WhoAmI", "FindEntries", "WatchEvents"),
        *("ReadDatasetEntry", "GetDatasetSchema", "GetDatasetManifestSchema", "ScanDatasetManifest"),
        *("GetSegmentTableSchema", "ScanSegmentTable", "GetSegmentProperties", "GetAssetsForSegment"),
        *("QueryDataset", "FindChunks", "FetchChunks", "GetRrdManifest", "GetSchemas"),
        *("ReadTableEntry", "GetTableSchema", "ScanTable"),
    }
)
"""Methods of Rerun 0.41's catalogue that change nothing."""
_OPTIONS = (
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
    ("grpc.so_reuseport", 0),  # else a second server could listen at the same port, and half of the calls reach it
)
_OWN = ("grpc-", ":", "user-agent", "content-type", "te")
"""Headers that each connection makes for itself begin with these."""
_GRACE_S = 1.0
_Behaviour = Callable[[AsyncIterator[bytes], grpc.aio.ServicerContext], AsyncIterator[bytes]]


@contextmanager
def read_only(server_url: str, host: str, port: int) -> Iterator[str]:
    """Let others read from a server for as long as the context lasts; gives the URL of the door.

    server_url, and the answer: as "rerun+http://127.0.0.1:51234". port: 0 for any that is free.
    Raises InputError where the address cannot be had.
    """
    scheme, _, server = server_url.partition("://")
    address = f"[{host}]" if ":" in host else host
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever, name="read-only door", daemon=True)
    thread.start()
    try:
        try:
            opening = _open(server, f"{address}:{port}")
            door, channel, bound = asyncio.run_coroutine_threadsafe(opening, loop).result()
        except RuntimeError as error:
            raise InputError(f"{host}:{port}: no server can listen there; choose another --host or --port") from error
        try:
            yield f"{scheme}://{address}:{bound}"
        finally:
            asyncio.run_coroutine_threadsafe(door.stop(_GRACE_S), loop).result()
            asyncio.run_coroutine_threadsafe(channel.close(), loop).result()
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join()
        loop.close()


async def _open(server: str, address: str) -> tuple[grpc.aio.Server, grpc.aio.Channel, int]:
    """The door, its channel to the server, and the port that it listens at."""
    channel = grpc.aio.insecure_channel(server, options=_OPTIONS)
    door = grpc.aio.server(handlers=[_Handler(channel)], options=_OPTIONS)
    try:
        bound = door.add_insecure_port(address)
        await door.start()
    except BaseException:
        await channel.close()
        raise
    return door, channel, bound


class _Handler(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Every method takes and gives streams of bytes: on the wire a single message is a stream of one."""

    def __init__(self, channel: grpc.aio.Channel) -> None:
        self._channel = channel

    def service(self, details: grpc.HandlerCallDetails) -> grpc.RpcMethodHandler:
        method = str(details.method)
        allowed = method.startswith(_SERVICE) and method.removeprefix(_SERVICE) in READING
        return grpc.stream_stream_rpc_method_handler(self._pass_on(method) if allowed else _refuse)

    def _pass_on(self, method: str) -> _Behaviour:
        async def pass_on(requests: AsyncIterator[bytes], context: grpc.aio.ServicerContext) -> AsyncIterator[bytes]:
            metadata = [(key, value) for key, value in context.invocation_metadata() if not key.startswith(_OWN)]
            call = self._channel.stream_stream(method)(requests, metadata=metadata)
            try:
                await context.send_initial_metadata(_plain(await call.initial_metadata()))
                async for response in call:
                    yield response
                context.set_trailing_metadata(_plain(await call.trailing_metadata()))
            except grpc.aio.AioRpcError as error:
                await context.abort(error.code(), error.details() or "", _plain(error.trailing_metadata()))
            finally:
                call.cancel()

        return pass_on


async def _refuse(_: AsyncIterator[bytes], context: grpc.aio.ServicerContext) -> AsyncIterator[bytes]:
    await context.abort(
        grpc.StatusCode.PERMISSION_DENIED, "this catalogue can only be read: 'ffmap serve' takes no changes"
    )
    yield b""  # an iterator, as the handler has to be


def _plain(metadata: grpc.aio.Metadata | None) -> tuple[tuple[str, str | bytes], ...]:
    return tuple((key, value) for key, value in metadata or () if not key.startswith(_OWN))
