"""Draws of hypothesis are the same on every run, and are not kept."""

from hypothesis import settings

settings.register_profile("posecal", derandomize=True, deadline=None, max_examples=25, database=None)
settings.load_profile("posecal")
