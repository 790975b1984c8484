"""Imported by the workers' server before anything else: from here on it ignores Ctrl-C, and so do those that fork from it.

Nothing else imports it: the run's own process does not ignore the user.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_IGN)
