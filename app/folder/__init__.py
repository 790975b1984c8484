"""The files of a run folder: their names, readers and writers."""
