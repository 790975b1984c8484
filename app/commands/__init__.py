"""One file per command of ffmap."""
