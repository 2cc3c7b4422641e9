"""Draws of hypothesis are the same on every run, and are not kept. Tests run side by side: each has one BLAS thread."""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported; the commands that tests run inherit it

from hypothesis import settings

settings.register_profile("posecal", derandomize=True, deadline=None, max_examples=25, database=None)
settings.load_profile("posecal")
