"""Write files whole: each is written as NAME.part and renamed."""

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield NAME.part, and rename it at the end; after an exception it is removed."""
    part = path.with_name(path.name + ".part")
    try:
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def write_text(path: Path, text: str) -> None:
    """Write a text in UTF-8."""
    with written_whole(path) as part:
        part.write_text(text, "utf-8")


def write_json(path: Path, content: object) -> None:
    """Write JSON; numbers that are not finite become null, arrays lists."""
    plain = to_jsonable_python(
        content, inf_nan_mode="null", fallback=lambda of_numpy: of_numpy.tolist()
    )
    write_text(path, json.dumps(plain, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def write_geojson(path: Path, features: Sequence[dict[str, Any]]) -> None:
    """Write a FeatureCollection whose coordinates are metres in the map frame."""
    numbered = [{"type": "Feature", "id": i, **feature} for i, feature in enumerate(features)]
    write_json(path, {"type": "FeatureCollection", "features": numbered})
