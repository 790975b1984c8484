"""Grid maps as files: map_server's YAML with its image, and images of other systems."""

import warnings
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
import yaml
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.folder.atomic import write_text, written_whole
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_yaml, require_regular

FREE_THRESHOLD = 0.196
"""Nav2 reads a pixel as free below it. Unknown cells have (255 − 205) / 255 = 0.1961: its usual
0.25 would make them free."""
IMAGES = (
    *(".png", ".pgm", ".pbm", ".ppm", ".bmp", ".jpg", ".jpeg"),
    *(".tif", ".tiff", ".gif", ".webp"),
)
_LOSSY = (".jpg", ".jpeg", ".webp")
_WHITE, _BLACK = 250.5, 100.5
"""Grey values above and below which an image without YAML is free and occupied: map_server writes
254 for free, drawings have 255."""
_RESOLUTION_MIN_M, _RESOLUTION_MAX_M = 1e-4, 1.0
_ORIGIN_MAX_M = 1e8
"""Larger than any projected coordinate; at larger ones 64-bit numbers do not resolve cells."""
PIXELS_MAX = 600_000_000
"""Larger images do not fit into the memory of a small computer."""

_Coordinate = Annotated[float, Field(ge=-_ORIGIN_MAX_M, le=_ORIGIN_MAX_M)]


class MapDescription(BaseModel):
    """A map_server YAML file; missing keys have map_server's defaults."""

    model_config = ConfigDict(frozen=True)

    image: str
    resolution: float = Field(ge=_RESOLUTION_MIN_M, le=_RESOLUTION_MAX_M)
    origin: tuple[_Coordinate, _Coordinate, _Coordinate] = (0.0, 0.0, 0.0)
    negate: bool = False
    occupied_thresh: float = Field(0.65, ge=0, le=1)
    free_thresh: float = Field(0.25, ge=0, le=1)
    mode: Literal["trinary", "scale", "raw"] = "trinary"

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.free_thresh > self.occupied_thresh:
            raise ValueError("free_thresh is above occupied_thresh")
        if self.origin[2] != 0.0:
            raise ValueError("origin has a yaw; set it to 0 and turn the image")
        return self


def write_grid(path: Path, grid: GridMap) -> None:
    """Write `path` (…/NAME.yaml) and NAME.pgm for Nav2's map_server; the first row is the top."""
    image = path.with_suffix(".pgm")
    description = {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(grid.cell_m),
        "origin": [float(grid.origin[0]), float(grid.origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": FREE_THRESHOLD,
    }
    with written_whole(image) as part:
        Image.fromarray(grid.cells[::-1]).save(part, format="PPM")
    write_text(path, yaml.safe_dump(description, sort_keys=False, default_flow_style=None))


def read_map(path: Path, resolution_m: float | None = None) -> GridMap:
    """Read the grid map of a .yaml file or of an image (see `IMAGES`).

    resolution_m: edge of a pixel; required for an image, takes precedence over the YAML file's.
    Raises InputError where the file is no map.
    """
    if resolution_m is not None and not _RESOLUTION_MIN_M <= resolution_m <= _RESOLUTION_MAX_M:
        raise InputError(
            f"--resolution {resolution_m:g}: give the edge of a pixel in metres, as in 0.05; "
            f"{_RESOLUTION_MAX_M:g} at most, because larger pixels show no door"
        )
    if path.suffix.lower() in (".yaml", ".yml"):
        description = _read_description(path)
        named = path.parent / description.image
        # map_saver writes the absolute path on the computer where the map was made.
        image = next((file for file in (named, path.parent / named.name) if file.is_file()), named)
        pixels = read_image(image, f"{path}: its image ")
    elif path.suffix.lower() not in IMAGES:
        raise InputError(
            f"{path}: is no map; give map_server's YAML file, or an image ({', '.join(IMAGES)})"
        )
    elif resolution_m is None:
        raise InputError(
            f"{path}: an image has no scale; give map_server's YAML file that names it, or "
            "--resolution METRES of a pixel"
        )
    else:
        image, pixels = path, read_image(path)
        description = MapDescription(
            image=path.name,
            resolution=resolution_m,
            occupied_thresh=1.0 - _BLACK / 255,
            free_thresh=1.0 - _WHITE / 255,
        )
    if image.suffix.lower() in _LOSSY and description.mode != "raw" and not description.negate:
        pixels = _without_noise(pixels)
    cells = np.ascontiguousarray(_cells(pixels, description)[::-1])
    return GridMap(cells, np.array(description.origin[:2]), resolution_m or description.resolution)


def read_image(path: Path, what: str = "") -> UInt8Array:
    """Read an image's grey values (rows, columns), the top row first; transparent is unknown.

    what: names the image in the error message. Raises InputError where the file is no image, or
    too large.
    """
    require_regular(path, "give a PNG or PGM file", what)
    try:
        with warnings.catch_warnings():
            # PIXELS_MAX is the limit here.
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            Image.MAX_IMAGE_PIXELS, before = None, Image.MAX_IMAGE_PIXELS
            try:
                return _grey(path, what)
            finally:
                Image.MAX_IMAGE_PIXELS = before
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{what}{path} is no image that can be read ({reason}); give a PNG or PGM file"
        ) from error


def _grey(path: Path, what: str) -> UInt8Array:
    with Image.open(path) as image:
        if image.width * image.height > PIXELS_MAX:
            size = f"{image.width} × {image.height} pixels, more than {PIXELS_MAX:,}"
            raise InputError(f"{what}{path} has {size}; give a part of it")
        if image.mode in ("I", "I;16", "F"):
            raise InputError(f"{what}{path} has more than 8 bits a pixel; save it with 8 bits")
        if "A" in image.getbands() or "transparency" in image.info:
            rgba = image.convert("RGBA")
            if np.asarray(rgba.getchannel("A")).min(initial=255) < 255:  # something is transparent
                ground = Image.new("RGBA", image.size, (int(Cell.UNKNOWN),) * 3)
                ground.alpha_composite(rgba)
                return np.asarray(ground.convert("L"))
        return np.asarray(image.convert("L"))


def _without_noise(pixels: UInt8Array) -> UInt8Array:
    """Replace the noise of lossy compression by the nearest of a map's three grey values."""
    levels = np.sort(np.array(list(Cell), np.uint8))
    nearest = np.abs(np.arange(256)[:, None] - levels.astype(int)).argmin(axis=1)
    return np.asarray(levels[nearest][pixels])


def _read_description(path: Path) -> MapDescription:
    content = read_yaml(path, "give a YAML file of map_server's")
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no keys and values; give a YAML file of map_server's")
    mode = str(content.get("mode", "trinary")).lower()
    try:
        return MapDescription.model_validate(content | {"mode": mode})
    except ValidationError as error:
        first = error.errors()[0]
        problem = first["msg"].removeprefix("Value error, ").lower()
        name = "".join(f"{part}: " for part in first["loc"])
        raise InputError(f"{path}: {name}{problem}; see map_server's documentation") from None


def _cells(pixels: UInt8Array, description: MapDescription) -> UInt8Array:
    """Classify pixels as map_server does; its modes trinary and scale agree on free cells."""
    grey = np.arange(256)
    table = np.full(256, Cell.UNKNOWN, np.uint8)
    if description.mode == "raw":
        table[grey == 0] = Cell.FREE
        table[(grey >= 100) & (grey < 255)] = Cell.OCCUPIED
        return np.asarray(table[pixels])
    occupied = grey / 255 if description.negate else (255 - grey) / 255
    table[occupied > description.occupied_thresh] = Cell.OCCUPIED
    table[occupied < description.free_thresh] = Cell.FREE
    if not description.negate:
        # map_server saves unknown as 205, slightly below its own default threshold for free.
        table[Cell.UNKNOWN] = Cell.UNKNOWN
    return np.asarray(table[pixels])
