"""Digests of a bag's clouds, message by message: two bags have the same ones only if every byte that is used is the same,
however many messages are gathered to a cloud.

XXH3 of 128 bits is as fast as memory is read, and clouds that differ by accident do not share it. It is no protection
against somebody who makes two clouds alike on purpose.
"""

from collections.abc import Iterable, Sequence

import numpy as np
import xxhash

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.loaders.bag import RawMessage

DIGEST_BYTES = 16


def digest_of(message: RawMessage) -> bytes:
    """The digest of all bytes of a message, its header included."""
    return xxhash.xxh3_128_digest(message.data)


def joined(digests: Iterable[bytes]) -> bytes:
    """One digest of several, in their order."""
    return xxhash.xxh3_128_digest(b"".join(digests))


def as_rows(digests: Sequence[bytes]) -> UInt8Array:
    """(n, 16), to be kept in a file."""
    return np.frombuffer(b"".join(digests), np.uint8).reshape(-1, DIGEST_BYTES)
