"""Files that are there are complete: each is written as NAME.part and renamed. What needs no bag is written here."""

import json
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """NAME.part to fill, which gets its name at the end of the context; an earlier file stays until then.

    After an exception nothing is left of it.
    """
    part = path.with_name(path.name + ".part")
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """A text in UTF-8."""
    with written_whole(path) as part:
        part.write_text(text, "utf-8")


def write_json(path: Path, content: object) -> None:
    """Readable JSON; numbers that are not finite become null, arrays lists."""
    write_text(path, json.dumps(_plain(content), indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_geojson(path: Path, features: Sequence[dict[str, Any]]) -> None:
    """A FeatureCollection whose coordinates are metres in the map frame."""
    numbered = [{"type": "Feature", "id": i, **feature} for i, feature in enumerate(features)]
    write_json(path, {"type": "FeatureCollection", "features": numbered})


def _plain(value: object) -> object:
    """Numbers, lists and dictionaries in place of numpy's; null in place of what JSON cannot say."""
    match value:
        case np.ndarray():
            return _plain(value.tolist())
        case np.generic():
            return _plain(value.item())
        case float():
            return value if math.isfinite(value) else None
        case dict():
            return {str(key): _plain(item) for key, item in value.items()}
        case list() | tuple():
            return [_plain(item) for item in value]
    return value
