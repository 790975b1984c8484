"""Errors that a user can fix: a wrong file, topic, frame or setting."""

import re

from pydantic import ValidationError

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")
_LENGTH_MAX = 300


class InputError(Exception):
    """One line: the file, topic or setting, the problem, and the fix.

    Control characters of files and users are replaced, so that they do not reach the terminal.
    """

    def __init__(self, line: str) -> None:
        super().__init__(_CONTROL.sub(" ", line))


class CloudError(InputError):
    """A point cloud that is inconsistent, so that none of its points can be used."""


def shortened(text: object) -> str:
    """Format text from files and users for one line: without line breaks, cut where it is long."""
    line = " ".join(str(text).split())
    return line if len(line) <= _LENGTH_MAX else f"{line[:_LENGTH_MAX]} …"


def first_problem(error: ValidationError) -> str:
    """Format the first problem that pydantic found, with its place."""
    first = error.errors()[0]
    place = ".".join(str(part) for part in first["loc"])
    message = shortened(first["msg"].removeprefix("Value error, "))
    return f"{place}: {message}" if place else message
