"""Tests run alike everywhere: the same draws of hypothesis, one BLAS thread each, and SIGINT that interrupts.

A test run in the background inherits an ignored SIGINT, and would hand it on to the commands that are interrupted.
"""

import os
import signal
from collections.abc import Iterator

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before NumPy is imported; the commands that tests run inherit it
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest
from hypothesis import settings

import posecal
from posecal.registry import registered_metrics

settings.register_profile("posecal", derandomize=True, deadline=None, max_examples=25, database=None)
settings.load_profile("posecal")


@pytest.fixture
def nothing_stays_registered() -> Iterator[None]:
    """Forget the metrics that a test registers."""
    yield
    for metric in registered_metrics():
        posecal.unregister(metric.name)
