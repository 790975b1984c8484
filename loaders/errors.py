"""What a user can put right: a wrong file, topic, frame or setting."""


class InputError(Exception):
    """One line that names the file, topic or setting, says what is wrong with it and what to do."""


class CloudError(InputError):
    """A point cloud message that contradicts itself, so that none of its points can be trusted."""
