"""What a user can put right: a wrong file, topic, frame or setting."""

import re


class InputError(Exception):
    """One line that names the file, topic or setting, says what is wrong with it and what to do.

    Line breaks and other control characters in what files and users say do not break it, nor reach the terminal.
    """

    def __init__(self, line: str) -> None:
        super().__init__(_CONTROL.sub(" ", line))


_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]+")


def shortened(words: object) -> str:
    """What a file or a user says, as a part of one line: without line breaks, and cut where it is long."""
    said = " ".join(str(words).split())
    return said if len(said) <= _LONGEST else f"{said[:_LONGEST]} …"


_LONGEST = 300


class CloudError(InputError):
    """A point cloud message that contradicts itself, so that none of its points can be trusted."""
