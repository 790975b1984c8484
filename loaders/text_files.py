"""Text files of users: read whole, of a bounded size, as TOML, YAML or JSON.

Pipes and devices are refused before they are opened: reading them may block or never end.
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
"""Of a file that a person writes: all settings have 18 kB; YAML of 100 kB takes a second."""
SETTINGS_LINE_MAX = 1000
"""Characters of a line of TOML; the time for a dotted name grows with the square of its length."""


def require_regular(path: Path, advice: str, what: str = "") -> None:
    """Raise InputError where there is no file: nothing, a folder, a pipe or a device.

    advice: end of the error's line. what: its beginning.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        raise InputError(f"{what}{path}: is not there; {advice}") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{what}{path}: cannot be read ({_reason(error)}); {advice}") from error
    if stat.S_ISREG(mode):
        return
    kind = "a device or a socket"
    if stat.S_ISDIR(mode):
        kind = "a folder"
    elif stat.S_ISFIFO(mode):
        kind = "a pipe"
    raise InputError(f"{what}{path}: is {kind}, not a file; {advice}")


def read_text(path: Path, advice: str, bytes_max: int = TEXT_BYTES_MAX) -> str:
    """Read a UTF-8 file of at most `bytes_max` bytes.

    Raises InputError, which ends with `advice`, where it is no such file.
    """
    require_regular(path, advice)
    try:
        if path.stat().st_size > bytes_max:
            raise InputError(f"{path}: has more than {bytes_max:,} bytes; {advice}")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({_reason(error)}); {advice}") from error
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no text ({error}); {advice}") from error


def read_toml(path: Path, advice: str) -> dict[str, Any]:
    """Read a TOML file; see `read_text`."""
    return dict(_parsed(_toml, path, "TOML", advice, SETTINGS_BYTES_MAX))


def _toml(text: str) -> dict[str, Any]:
    if max(map(len, text.splitlines()), default=0) > SETTINGS_LINE_MAX:
        raise ValueError(f"a line of more than {SETTINGS_LINE_MAX} characters")
    return tomllib.loads(text)


def read_yaml(path: Path, advice: str) -> Any:  # noqa: ANN401 - whatever the file contains
    """Read a YAML file by the safe loader; see `read_text`."""
    return _parsed(yaml.safe_load, path, "YAML", advice, SETTINGS_BYTES_MAX)


def read_json(path: Path, advice: str) -> Any:  # noqa: ANN401 - as above
    """Read a JSON file; see `read_text`."""
    return _parsed(json.loads, path, "JSON", advice, TEXT_BYTES_MAX)


def read_object(path: Path, advice: str) -> dict[str, Any]:
    """Read a JSON file of names and values; see `read_text`."""
    content = read_json(path, advice)
    if not isinstance(content, dict):
        raise InputError(f"{path}: contains no names and values; {advice}")
    return content


def dotted_keys(values: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Flatten nested values to TOML's dotted keys."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat |= dotted_keys(value, f"{prefix}{name}.")
        else:
            flat[prefix + name] = value
    return flat


def _parsed(
    parse: Callable[[str], Any], path: Path, language: str, advice: str, bytes_max: int
) -> Any:  # noqa: ANN401 - as above
    text = read_text(path, advice, bytes_max)
    try:
        return parse(text)
    except (ValueError, OverflowError, yaml.YAMLError) as error:
        raise InputError(f"{path}: is no valid {language} ({_reason(error)}); {advice}") from error
    except RecursionError:
        raise InputError(f"{path}: its {language} is nested too deeply; {advice}") from None


def _reason(error: Exception) -> str:
    return shortened((error.strerror if isinstance(error, OSError) else None) or error)
