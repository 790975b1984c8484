"""Text files that users give: read whole, of a bounded size, as TOML, YAML or JSON.

What is no regular file is refused before it is opened: reading a pipe blocks, and a device such as /dev/zero never ends.
"""

import json
import stat
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import yaml

from ffmap.loaders.errors import InputError, shortened

TEXT_BYTES_MAX = 64 << 20  # A trajectory of 100 hours at 10 Hz has 40 MB
SETTINGS_BYTES_MAX = 64 << 10
"""Of a file that a person writes: all settings with their descriptions have 18 kB; YAML of 100 kB takes a second."""
SETTINGS_LINE_MAX = 1000
"""Characters of a line of TOML; the time that a dotted name takes grows with the square of its length."""


def require_regular(path: Path, advice: str, what: str = "") -> None:
    """Raises InputError where `path` is not there, or is a folder, a pipe or a device. advice: what the user can do;
    the end of the error's line. what: its beginning, where the path alone says too little.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"{what}{path}: is not there; {advice}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{what}{path}: cannot be read ({_reason(error)}); {advice}") from error
    if not stat.S_ISREG(mode):
        raise InputError(f"{what}{path}: is {_kind(mode)}, not a file; {advice}")


def _kind(mode: int) -> str:
    if stat.S_ISDIR(mode):
        return "a folder"
    return "a pipe" if stat.S_ISFIFO(mode) else "a device or a socket"


def read_text(path: Path, advice: str, bytes_max: int = TEXT_BYTES_MAX) -> str:
    """The text of a UTF-8 file. advice: what the user can do, as "give a TUM file"; it ends the one line of every
    InputError. Raises InputError where it is no file of text, cannot be read, or has more than `bytes_max` bytes.
    """
    require_regular(path, advice)
    try:
        if path.stat().st_size > bytes_max:
            raise InputError(f"{path}: has more than {bytes_max:,} bytes, too many for what it should be; {advice}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({_reason(error)}); {advice}") from error
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text ({error}); {advice}") from error


def read_toml(path: Path, advice: str) -> dict[str, Any]:
    """A TOML file; `advice` and errors as of `read_text`."""
    return dict(_parsed(_toml, path, "TOML", advice, SETTINGS_BYTES_MAX))


def _toml(text: str) -> dict[str, Any]:
    if max(map(len, text.splitlines()), default=0) > SETTINGS_LINE_MAX:
        raise ValueError(f"a line of more than {SETTINGS_LINE_MAX} characters")
    return tomllib.loads(text)


def read_yaml(path: Path, advice: str) -> Any:  # noqa: ANN401 - whatever the file holds
    """A YAML file by the safe loader; `advice` and errors as of `read_text`."""
    return _parsed(yaml.safe_load, path, "YAML", advice, SETTINGS_BYTES_MAX)


def read_json(path: Path, advice: str) -> Any:  # noqa: ANN401 - as above
    """A JSON file; `advice` and errors as of `read_text`."""
    return _parsed(json.loads, path, "JSON", advice, TEXT_BYTES_MAX)


def read_object(path: Path, advice: str) -> dict[str, Any]:
    """A JSON file of names and values; `advice` and errors as of `read_text`."""
    content = read_json(path, advice)
    if not isinstance(content, dict):
        raise InputError(f"{path}: holds no names and values; {advice}")
    return content


def dotted_keys(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested values by TOML's dotted keys, as --set takes those of settings."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= dotted_keys(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _parsed(parse: Callable[[str], Any], path: Path, language: str, advice: str, bytes_max: int) -> Any:  # noqa: ANN401
    text = read_text(path, advice, bytes_max)
    try:
        return parse(text)
    except (ValueError, OverflowError, yaml.YAMLError) as error:
        raise InputError(f"{path}: is no valid {language} ({_reason(error)}); {advice}") from error
    except RecursionError:
        raise InputError(f"{path}: its {language} is nested too deeply; {advice}") from None


def _reason(error: Exception) -> str:
    return shortened((error.strerror if isinstance(error, OSError) else None) or error)
