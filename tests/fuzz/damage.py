"""Ways to damage bytes and texts."""

import copy
import json
import re
from collections.abc import Iterator, Sequence
from typing import Any

from hypothesis import strategies as st

_ENDS = 3000
"""Containers have their structure at the start and the end."""
_POWERS = (7, 8, 15, 16, 31, 32, 63, 64)
_NUMBERS = (0, 1, *(2**n for n in _POWERS), *(2**n - 1 for n in _POWERS))
WORDS = (
    "0", "-1", "1e300", "-1e300", "1e-300", "1e999999999", "nan", "inf", "0x7f", "1_0", "true",
    "null", "~", "[]", "{}", "''", "'", "é", "𝔘", "=", ",", "", '"', '""', '"\\u0000"', "\t", "\r",
    "\x00", "\n\n", "2024-13-45", "&a [*a]", "9" * 30, "9" * 5000, "[" * 2000, "{" * 2000,
    "a." * 400, "- " * 400, "!!python/object:os.system x", "../../etc/passwd", "/dev/zero",
)  # fmt: skip
_VALUES = (
    *(None, True, 0, -1, 1e300, 10**30, "", "0", "x" * 1000, "/dev/zero"),
    *([], {}, [[]], [None], [[0.0]], {"a": 1}),
)


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Cut, flip bits, insert, remove, repeat and replace numbers: one to four times."""
    data, size = bytearray(content), len(content)
    start = st.integers(0, min(_ENDS, size))
    place = st.one_of(st.integers(0, size), start, start.map(lambda n: size - n))
    for _ in range(draw(st.integers(1, 4))):
        at = draw(place)
        match draw(st.sampled_from(("flip", "cut", "insert", "remove", "number", "repeat"))):
            case "flip":
                if at < len(data):
                    data[at] ^= 1 << draw(st.integers(0, 7))
            case "cut":
                del data[at:]
            case "insert":
                data[at:at] = draw(st.binary(min_size=1, max_size=16))
            case "remove":
                del data[at : at + draw(st.integers(1, 64))]
            case "number":
                count = draw(st.sampled_from((1, 2, 4, 8)))
                value = draw(st.sampled_from(_NUMBERS)) % (1 << 8 * count)
                data[at : at + count] = value.to_bytes(count, "little")
            case _:
                data[at:at] = data[at : at + draw(st.integers(1, 4096))]
    return bytes(data)


@st.composite
def damaged_text(draw: st.DrawFn, text: str, more: Sequence[str] = ()) -> bytes:
    """Replace, remove and repeat words, also by those of `more`; or damage the bytes."""
    if draw(st.integers(0, 4)) == 0:
        return draw(damaged(text.encode()))
    parts = re.findall(r"\s+|\S+", text)
    words = [i for i, part in enumerate(parts) if not part.isspace()]
    others = st.one_of(
        st.sampled_from((*WORDS, *more)), st.text(max_size=20), st.floats().map(str), st.none()
    )
    for i in draw(st.lists(st.sampled_from(words), min_size=1, max_size=3)):
        new = draw(others)
        parts[i] = f"{parts[i]} {parts[i]}" if new is None else new
    return "".join(parts).encode(errors="replace")


@st.composite
def damaged_json(draw: st.DrawFn, text: str) -> bytes:
    """Replace and remove values of a JSON document; or damage the text."""
    if draw(st.integers(0, 2)) == 0:
        return draw(damaged_text(text))
    document = [json.loads(text)]
    for _ in range(draw(st.integers(1, 3))):
        holder, key = draw(st.sampled_from(list(_places(document))))
        if draw(st.integers(0, 3)) == 0 and holder is not document:
            del holder[key]
        else:
            holder[key] = copy.deepcopy(draw(st.sampled_from(_VALUES)))
    return json.dumps(document[0]).encode()


def _places(holder: Any) -> Iterator[tuple[Any, Any]]:
    """Yield the container and the key of every value in a document."""
    keys: Any = holder if isinstance(holder, dict) else ()
    if isinstance(holder, list):
        keys = range(len(holder))
    for key in list(keys):
        yield holder, key
        yield from _places(holder[key])
