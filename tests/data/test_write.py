"""Files are written whole or not at all, and where they can't be, that is said before any work."""

import os
import signal
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from posecal.data.write import check_writable, write_file, written_together
from posecal.errors import PoseFileError

ROOT = Path(__file__).parents[1]


@pytest.fixture(params=["unnamed", "no link", "named"], autouse=True)
def _every_way(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """As systems do that know files without names, as disks do that then refuse the name, and as others do."""

    def refuse(*_: object, **how: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    if request.param == "no link":
        monkeypatch.setattr(os, "link", refuse)
    if request.param == "named":
        monkeypatch.setattr("posecal.data.write._unnamed", lambda folder: None)


def test_a_file_is_written_whole_and_nothing_is_left_beside_it(tmp_path: Path) -> None:
    write_file(tmp_path / "a.txt", lambda file: file.write(b"words"))
    assert (tmp_path / "a.txt").read_bytes() == b"words"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_what_was_there_stays_where_writing_fails(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"before")

    def fail(file: Any) -> None:
        file.write(b"half of it")
        raise OSError(28, "No space left on device")

    with pytest.raises(PoseFileError, match=r"a\.txt: can't be written \(No space left on device\)\.$"):
        write_file(tmp_path / "a.txt", fail)
    assert (tmp_path / "a.txt").read_bytes() == b"before"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, RuntimeError])
def test_an_interruption_leaves_nothing_behind(tmp_path: Path, interruption: type[BaseException]) -> None:
    def stop(file: Any) -> None:
        file.write(b"half of it")
        raise interruption

    with pytest.raises(interruption):
        write_file(tmp_path / "a.txt", stop)
    assert list(tmp_path.iterdir()) == []


def test_a_process_that_is_killed_leaves_nothing_behind(tmp_path: Path) -> None:
    """Where files need no name; elsewhere a hidden one stays, which nothing reads."""
    script = (
        "import os, signal; from posecal.data.write import write_file\n"
        "write_file('a.txt', lambda file: (file.write(bytes(10**6)), os.kill(os.getpid(), signal.SIGKILL)))"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)})
    assert done.returncode == -signal.SIGKILL
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["x" * 255, "é" * 122 + ".npz"])
def test_a_long_name_is_written(tmp_path: Path, name: str) -> None:
    write_file(tmp_path / name, lambda file: file.write(b"words"))
    assert [(path.name, path.read_bytes()) for path in tmp_path.iterdir()] == [(name, b"words")]


def test_a_written_file_has_the_rights_that_the_user_gives_new_files(tmp_path: Path) -> None:
    before = os.umask(0o027)
    try:
        write_file(tmp_path / "a.txt", lambda file: file.write(b""))
        assert os.umask(0o027) == 0o027
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == 0o640


@pytest.mark.parametrize("rights", [0o600, 0o664, 0o400])
def test_a_file_that_is_replaced_keeps_its_rights(tmp_path: Path, rights: int) -> None:
    (tmp_path / "a.txt").write_bytes(b"before")
    (tmp_path / "a.txt").chmod(rights)
    seen = []
    write_file(tmp_path / "a.txt", lambda file: (file.write(b"words"), seen.append(os.fstat(file.fileno()).st_mode)))
    assert (tmp_path / "a.txt").read_bytes() == b"words"
    assert stat.S_IMODE((tmp_path / "a.txt").stat().st_mode) == rights
    assert stat.S_IMODE(seen[0]) == rights  # before there is anything to read


def test_contents_are_on_the_disk_before_the_name_and_the_name_before_the_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    fsync, replace = os.fsync, Path.replace

    def stored(number: int) -> None:
        is_folder = stat.S_ISDIR(os.fstat(number).st_mode)
        steps.append("folder" if is_folder else f"{os.fstat(number).st_size} bytes")
        fsync(number)

    def replaced(part: Path, target: Path) -> Path:
        steps.append("name")
        return replace(part, target)

    monkeypatch.setattr(os, "fsync", stored)
    monkeypatch.setattr(Path, "replace", replaced)
    write_file(tmp_path / "a.txt", lambda file: file.write(b"words"))
    assert list(dict.fromkeys(steps)) == ["5 bytes", "name", "folder"]


def test_files_that_are_written_together_appear_together(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"before")
    with written_together():
        write_file(tmp_path / "a.txt", lambda file: file.write(b"one"))
        with written_together():
            write_file(tmp_path / "b.txt", lambda file: file.write(b"two"))
        assert (tmp_path / "a.txt").read_bytes() == b"before"
        assert not (tmp_path / "b.txt").exists()
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.txt": b"one", "b.txt": b"two"}


def test_where_one_of_several_files_can_not_be_written_all_stay_as_they_were(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_bytes(b"before")

    def fail(_: Any) -> None:
        raise OSError(28, "No space left on device")

    @written_together()
    def write() -> None:
        write_file(tmp_path / "a.txt", lambda file: file.write(b"one"))
        write_file(tmp_path / "b.txt", fail)

    with pytest.raises(PoseFileError, match=r"b\.txt: can't be written \(No space left on device\)\.$"):
        write()
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == {"a.txt": b"before"}
    write_file(tmp_path / "b.txt", lambda file: file.write(b"two"))
    assert (tmp_path / "b.txt").read_bytes() == b"two"


def test_what_can_not_be_read_while_a_file_is_written_is_what_is_said(tmp_path: Path) -> None:
    def read(_: Any) -> None:
        raise PoseFileError("hyps.npz: was cut off.")

    with pytest.raises(PoseFileError, match=r"^hyps\.npz: was cut off\.$"):
        write_file(tmp_path / "a.txt", read)


def test_a_link_stays_a_link_and_what_it_points_to_is_written(tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "result.npz").symlink_to(tmp_path / "disk" / "result.npz")
    write_file(tmp_path / "result.npz", lambda file: file.write(b"words"))
    assert (tmp_path / "result.npz").is_symlink()
    assert (tmp_path / "disk" / "result.npz").read_bytes() == b"words"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("nowhere/a.txt", r"nowhere/a\.txt: the folder .*nowhere does not exist\. Make it first\."),
        ("file/a.txt", r"file/a\.txt: the folder .*file does not exist\. Make it first\."),
        ("folder", r"folder: is a folder; expected the name of a file\."),
        ("pipe", r"pipe: is a device or a pipe; expected the name of a file\."),
        ("lost", r"lost: the folder .*gone does not exist\. Make it first\."),
    ],
)
def test_what_can_not_be_written_is_said_before_any_work(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / "file").write_text("here")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "lost").symlink_to(tmp_path / "gone" / "a.txt")
    with pytest.raises(PoseFileError, match=f"{words}$"):
        check_writable(tmp_path / name)


def test_a_folder_that_takes_no_files_is_said() -> None:
    with pytest.raises(PoseFileError, match=r"^/proc/a\.txt: can't be written \(No such file or directory\)\.$"):
        check_writable("/proc/a.txt")


def test_a_device_is_never_replaced() -> None:
    with pytest.raises(PoseFileError, match=r"^/dev/null: is a device or a pipe; expected the name of a file\.$"):
        write_file("/dev/null", lambda file: file.write(b""))
    assert stat.S_ISCHR(os.stat("/dev/null").st_mode)
