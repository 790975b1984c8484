"""Ways in which bytes and texts are damaged."""

import copy
import json
import re
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from hypothesis import strategies as st

Edit = Callable[[bytearray], None]

_ENDS = 3000
"""Containers keep their structure at the start and the end."""
_NUMBERS = (0, 1, 2**7, 2**8 - 1, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63 - 1, 2**63, 2**64 - 1)


@st.composite
def damaged(draw: st.DrawFn, content: bytes) -> bytes:
    """Cut, bits flipped, bytes inserted, removed, repeated, numbers replaced: one to four times."""
    data = bytearray(content)
    for edit in draw(st.lists(_edits(len(content)), min_size=1, max_size=4)):
        edit(data)
    return bytes(data)


def _edits(size: int) -> st.SearchStrategy[Edit]:
    place = st.one_of(
        st.integers(0, size), st.integers(0, min(_ENDS, size)), st.integers(0, min(_ENDS, size)).map(lambda n: size - n)
    )
    return st.one_of(
        st.builds(_flip, place, st.integers(0, 7)),
        st.builds(_cut, place),
        st.builds(_replace, place, st.just(0), st.binary(min_size=1, max_size=16)),
        st.builds(_replace, place, st.integers(1, 64), st.just(b"")),
        st.builds(_number, place, st.sampled_from(_NUMBERS), st.sampled_from((1, 2, 4, 8))),
        st.builds(_repeat, place, st.integers(1, 4096)),
    )


def _flip(at: int, bit: int) -> Edit:
    def edit(data: bytearray) -> None:
        if at < len(data):
            data[at] ^= 1 << bit

    return edit


def _cut(at: int) -> Edit:
    def edit(data: bytearray) -> None:
        del data[at:]

    return edit


def _replace(at: int, count: int, by: bytes) -> Edit:
    def edit(data: bytearray) -> None:
        data[at : at + count] = by

    return edit


def _number(at: int, value: int, size: int) -> Edit:
    return _replace(at, size, (value % (1 << 8 * size)).to_bytes(size, "little"))


def _repeat(at: int, count: int) -> Edit:
    def edit(data: bytearray) -> None:
        data[at:at] = data[at : at + count]

    return edit


WORDS = (
    *(
        "",
        "0",
        "-1",
        "1e300",
        "-1e300",
        "1e-300",
        "1e999999999",
        "nan",
        "inf",
        "9" * 30,
        "9" * 5000,
        "0x7f",
        "1_0",
        "true",
    ),
    *(
        "null",
        "~",
        "[]",
        "{}",
        '""',
        '"\\u0000"',
        "'",
        '"',
        "[" * 2000,
        "{" * 2000,
        "a." * 400,
        "- " * 400,
        "\t",
        "\r",
        "\x00",
    ),
    *(
        "2024-13-45",
        "&a [*a]",
        "!!python/object:os.system x",
        "é",
        "𝔘",
        "../../etc/passwd",
        "/dev/zero",
        "=",
        ",",
        "\n\n",
    ),
)


@st.composite
def damaged_text(draw: st.DrawFn, text: str, more: Sequence[str] = ()) -> bytes:
    """Words of a text replaced, removed and repeated; or its bytes damaged. more: words that may stand in the place of one."""
    if draw(st.integers(0, 4)) == 0:
        return draw(damaged(text.encode()))
    parts = re.findall(r"\s+|\S+", text)
    words = [i for i, part in enumerate(parts) if not part.isspace()]
    for i in draw(st.lists(st.sampled_from(words), min_size=1, max_size=3)):
        new = draw(st.one_of(st.sampled_from((*WORDS, *more)), st.text(max_size=20), st.floats().map(str), st.none()))
        parts[i] = f"{parts[i]} {parts[i]}" if new is None else new
    return "".join(parts).encode(errors="replace")


_VALUES = (None, True, 0, -1, 1e300, 10**30, "", "0", "x" * 1000, "/dev/zero", [], {}, [[]], [None], [[0.0]], {"a": 1})


@st.composite
def damaged_json(draw: st.DrawFn, text: str) -> bytes:
    """Values of a JSON document replaced by ones of any kind, and left out; or the text damaged."""
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
    """Every value within a document, by what holds it and its key or index there."""
    keys = list(holder) if isinstance(holder, dict) else range(len(holder)) if isinstance(holder, list) else ()
    for key in keys:
        yield holder, key
        yield from _places(holder[key])
