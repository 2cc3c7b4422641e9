import os
import time

import numpy as np
import pytest

from posecal.data import child_process
from posecal.data.child_process import run_in_child, seconds_for, time_limit
from posecal.errors import PoseDataError, PoseFileError


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "poses.c3d"
    file.write_bytes(b"12345")
    return file


def numbers(count):
    os.write(1, b"what a library says")
    return np.arange(count)


def refuse(name):
    raise PoseDataError(f"{name}: no markers; expected some.")


def crash():
    os.abort()


def loop():
    while True:
        pass


def wait():
    time.sleep(100)


def claim(size):
    return len(bytearray(size))


def test_what_the_function_gives_comes_back(path):
    np.testing.assert_array_equal(run_in_child(path, numbers, 5), [0, 1, 2, 3, 4])


def test_a_refusal_comes_back_as_it_is(path):
    with pytest.raises(PoseDataError, match=r"^poses.c3d: no markers; expected some.$"):
        run_in_child(path, refuse, path.name)


def test_a_crash_is_a_refusal_of_the_file(path):
    with pytest.raises(PoseFileError, match=r"^poses.c3d: its library crashes on it. It is damaged"):
        run_in_child(path, crash)


@pytest.mark.parametrize("function", [loop, wait])
def test_what_never_ends_is_ended(path, monkeypatch, function):
    monkeypatch.setattr(child_process, "SECONDS", 0.5)
    monkeypatch.setattr(child_process, "_BUSY", 2 if function is wait else 100)
    with pytest.raises(PoseFileError, match=r"^poses.c3d: reading it takes more than 1 s"):
        run_in_child(path, function)


def test_memory_is_limited_by_the_size_of_the_file(path):
    assert run_in_child(path, claim, 1 << 20) == 1 << 20
    with pytest.raises(PoseFileError, match="it needs more memory than there is"):
        run_in_child(path, claim, 1 << 31)


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(PoseFileError, match="no such file"):
        run_in_child(tmp_path / "none.h5", numbers, 1)


def test_the_time_grows_with_the_file(path):
    path.write_bytes(bytes(3 << 20))
    assert seconds_for(path) == child_process.SECONDS + 3


def test_python_code_is_interrupted():
    with pytest.raises(TimeoutError, match="more than 0 s"), time_limit(0.05):
        loop()


def test_code_that_ends_in_time_is_left_alone():
    with time_limit(5):
        assert numbers(2).tolist() == [0, 1]
