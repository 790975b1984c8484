"""The program: `cli` parses, `commands` holds one file for each command.

Rooms, each of which uses only those before it: `setup` (settings and inputs), `folder` (the files of a run), `record` (the
Rerun recording), `run` (the stages of a run), `analysis` (finished runs), `sweeps`, `commands`.
"""
