"""Grid maps as files: map_server's YAML with its image, written and read; of other systems, the image alone."""

import warnings
from pathlib import Path
from typing import Literal

import numpy as np
import yaml
from PIL import Image
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.algorithms.maps.grid import Cell, GridMap
from ffmap.app.folder.atomic import write_text, written_whole
from ffmap.loaders.errors import InputError
from ffmap.loaders.text_files import read_yaml, require_regular

WHITE_MIN = 251
"""Minimum grey value of what is free, without a YAML file: map_server writes 254, drawings 255."""
BLACK_MAX = 100
FREE_THRESHOLD = 0.196
"""Nav2 reads a pixel p as free below it: (255 − 205) / 255 = 0.1961 has to stay unknown, so its usual 0.25 will not do."""
IMAGES = (".png", ".pgm", ".pbm", ".ppm", ".bmp", ".jpg", ".jpeg", ".tif", ".tiff", ".gif", ".webp")
_LOSSY = (".jpg", ".jpeg", ".webp")
RESOLUTION_MAX_M = 1.0
RESOLUTION_MIN_M = 1e-4
ORIGIN_MAX_M = 1e8
"""More than any projected coordinates; a grid cannot be laid out further off in 64-bit numbers."""
PIXELS_MAX = 600_000_000
"""What is larger does not fit into the memory of a small computer."""


class MapDescription(BaseModel):
    """A map_server YAML file; what it may leave out has map_server's own defaults."""

    model_config = ConfigDict(frozen=True)

    image: str
    resolution: float = Field(ge=RESOLUTION_MIN_M, le=RESOLUTION_MAX_M)
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    negate: bool = False
    occupied_thresh: float = Field(0.65, ge=0, le=1)
    free_thresh: float = Field(0.25, ge=0, le=1)
    mode: Literal["trinary", "scale", "raw"] = "trinary"


def write_grid(path: Path, grid: GridMap) -> None:
    """`path` (…/NAME.yaml) and NAME.pgm beside it, as Nav2's map_server reads them; the image's first row is the top."""
    image = path.with_suffix(".pgm")
    rows, columns = grid.cells.shape
    pixels = np.ascontiguousarray(grid.cells[::-1], np.uint8).tobytes()
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
        part.write_bytes(f"P5\n{columns} {rows}\n255\n".encode() + pixels)
    write_text(path, yaml.safe_dump(description, sort_keys=False, default_flow_style=None))


def read_map(path: Path, resolution_m: float | None = None) -> GridMap:
    """The grid map of a .yaml, or of an image (see `IMAGES`).

    resolution_m: edge of a pixel in metres; needed for an image without YAML, in the place of the YAML's otherwise.
    The origin's yaw turns the map; it is refused where it is not 0, for rooms are given in the map's frame.
    Raises InputError where it is no map.
    """
    if resolution_m is not None and not RESOLUTION_MIN_M <= resolution_m <= RESOLUTION_MAX_M:
        most = f"{RESOLUTION_MAX_M:g} at most, for larger pixels show no door"
        raise InputError(f"--resolution {resolution_m:g}: give the edge of a pixel in metres, as in 0.05; {most}")
    if path.suffix.lower() in (".yaml", ".yml"):
        description = _read_description(path)
        named = path.parent / description.image
        # map_saver writes an absolute path, of the computer where the map was made.
        image = next((file for file in (named, path.parent / named.name) if file.is_file()), named)
        pixels = read_image(image, f"{path}: its image ")
        three_values = description.mode != "raw" and not description.negate
        cells = _cells(_without_noise(pixels, image) if three_values else pixels, description)
        origin = np.array(description.origin[:2])
        return GridMap(np.ascontiguousarray(cells[::-1]), origin, resolution_m or description.resolution)
    if path.suffix.lower() not in IMAGES:
        raise InputError(f"{path}: is no map; give map_server's YAML file, or an image ({', '.join(IMAGES)})")
    if resolution_m is None:
        raise InputError(
            f"{path}: an image has no scale; give map_server's YAML file that names it, or --resolution METRES of a pixel"
        )
    pixels = _without_noise(read_image(path), path)
    cells = np.select([pixels >= WHITE_MIN, pixels <= BLACK_MAX], [Cell.FREE, Cell.OCCUPIED], Cell.UNKNOWN)
    cells = cells.astype(np.uint8)
    return GridMap(np.ascontiguousarray(cells[::-1]), np.zeros(2), resolution_m)


def read_image(path: Path, what: str = "") -> UInt8Array:
    """Grey values (rows, columns) of an image, its first row the uppermost; transparent is unknown.

    what: names the image in an error's line. Raises InputError where it is none, or too large.
    """
    require_regular(path, "give a PNG or PGM file", what)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # PIXELS_MAX is the limit here
            Image.MAX_IMAGE_PIXELS, before = None, Image.MAX_IMAGE_PIXELS
            try:
                return _grey(path, what)
            finally:
                Image.MAX_IMAGE_PIXELS = before
    except (OSError, ValueError, SyntaxError, EOFError) as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{what}{path} is no image that can be read ({reason}); give a PNG or PGM file") from error


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


def _without_noise(pixels: UInt8Array, path: Path) -> UInt8Array:
    """Of an image with lossy compression the nearest of a map's three grey values: others are noise, most of it near walls."""
    if path.suffix.lower() not in _LOSSY:
        return pixels
    levels = np.sort(np.array(list(Cell), np.uint8))
    nearest = np.abs(np.arange(256)[:, None] - levels.astype(int)).argmin(axis=1)
    return np.asarray(levels[nearest][pixels])


def _read_description(path: Path) -> MapDescription:
    content = read_yaml(path, "give a YAML file of map_server's")
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no keys and values; give a YAML file of map_server's")
    try:
        description = MapDescription.model_validate(content | {"mode": str(content.get("mode", "trinary")).lower()})
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{path}: {name}: {first['msg'].lower()}; see map_server's documentation") from None
    if description.free_thresh > description.occupied_thresh:
        raise InputError(f"{path}: free_thresh is above occupied_thresh; see map_server's documentation")
    if not all(abs(value) <= ORIGIN_MAX_M for value in description.origin):
        raise InputError(
            f"{path}: origin is not finite, or further off than {ORIGIN_MAX_M:g} m; give x, y and yaw in metres and radians"
        )
    if description.origin[2] != 0.0:
        raise InputError(f"{path}: origin has a yaw, which most programs ignore; set it to 0 and turn the image")
    return description


def _cells(pixels: UInt8Array, description: MapDescription) -> UInt8Array:
    """As map_server decides, by a table of all grey values; its modes trinary and scale tell the same cells free."""
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
        table[Cell.UNKNOWN] = Cell.UNKNOWN  # what map_server saves as unknown is just under its own default for free
    return np.asarray(table[pixels])
