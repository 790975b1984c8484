"""The program: `cli` parses, `commands` holds one file per command.

Each folder uses only those before it: `setup` (settings and inputs), `folder` (files of a run),
`record` (the Rerun recording), `run` (stages of a run), `analysis` (finished runs), `commands`.
"""
