"""Hypothesis tries a few examples, always the same; with --hypothesis-profile=long, many.

The environment is that of the program: set before NumPy or Numba are imported.
"""

import os

from hypothesis import HealthCheck, settings

from ffmap.app.compiled_code import compiled_code
from ffmap.app.run.workers import ENVIRONMENT

os.environ.update(ENVIRONMENT | os.environ | compiled_code())

_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.filter_too_much]

settings.register_profile(
    "default", derandomize=True, deadline=None, max_examples=5, suppress_health_check=_SLOW
)
settings.register_profile(
    "long", deadline=None, max_examples=1200, suppress_health_check=_SLOW, print_blob=True
)
settings.load_profile("default")
