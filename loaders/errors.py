"""What a user can put right: a wrong file, topic, frame or setting."""


class InputError(Exception):
    """One line that names the file, topic or setting, says what is wrong with it and what to do."""


def shortened(words: object) -> str:
    """What a file or a user says, as a part of one line: without line breaks, and cut where it is long."""
    said = " ".join(str(words).split())
    return said if len(said) <= _LONGEST else f"{said[:_LONGEST]} …"


_LONGEST = 300


class CloudError(InputError):
    """A point cloud message that contradicts itself, so that none of its points can be trusted."""
