"""The stages of a run, the processes that do their work, and the cache of odometries."""
