"""Imported by the server of the workers before it forks them: imports take two seconds."""

import signal

# Ctrl-C reaches all processes of a terminal; the run ends this one.
signal.signal(signal.SIGINT, signal.SIG_IGN)

import ffmap.app.run.final  # noqa: E402, F401
