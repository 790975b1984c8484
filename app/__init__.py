"""The program: command line, settings, pipeline, recorder, run folder."""
