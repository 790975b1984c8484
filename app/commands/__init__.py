"""One file for each command of ffmap: what it asks, calls and prints."""
