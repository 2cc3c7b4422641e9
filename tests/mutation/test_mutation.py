"""Mutants are made where they should be, planted faults are told apart, and the working tree stays as it is."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutation.__main__ import find_tests, survivors
from tests.mutation.mutants import mutants_of

ROOT = Path(__file__).parents[2]
SURVIVORS = Path(__file__).with_name("survivors.toml")
MODULE = '''\
"""A module."""
from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Literal

__all__ = ["clip", "unused"]


def clip(x: float, limit: Literal[1, 2] = 1) -> float:
    """Below the limit."""
    if x < limit:
        return x
    return limit


def unused(x: float) -> float:
    return x * 3


def apart(x: int) -> int:
    return x + 5  # no mutant: of another test
'''
TESTS = """\
import subprocess
import sys

import package.module as module


def test_clip():
    assert module.clip(0.5) == 0.5
    assert module.clip(4) == module.clip(1) == 1


def test_another_process_sees_the_same_module():
    words = "import package.module as m; print(m.clip(-3))"
    assert subprocess.run([sys.executable, "-c", words], capture_output=True, text=True).stdout == "-3\\n"
"""


def changes(source: str, strings: bool = False) -> list[str]:
    return [mutant.change for mutant in mutants_of("m.py", source, strings)]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("a < b", ["a < b -> a <= b", "a < b -> a >= b"]),
        ("a < b <= c", ["-> a <= b <= c", "-> a >= b <= c", "-> a < b < c", "-> a < b > c"]),
        ("a is None", ["a is None -> a is not None"]),
        ("a + b", ["a + b -> a - b"]),
        ("a *= b", ["a *= b -> a /= b"]),
        ("a and b", ["a and b -> a or b"]),
        ("a[1:]", ["1 -> 2", "1 -> 0"]),
        ("a = 0.5, 0.0, True", ["0.5 -> 1.0", "0.0 -> 1.0", "True -> False"]),
        ("not a", ["not a -> a"]),
        ("-a", ["-a -> a"]),
        ("a[-1] = -0.5", ["-1 -> 0", "-1 -> -2", "-0.5 -> 0.5", "-0.5 -> -1.0"]),
        ("y = x.min(axis=a)", ["-> x.max(axis=a)", "-> x.min()"]),
        ("y = np.sort(x, axis=-1), x.sort(axis=a)", ["-1 -> 0", "-1 -> -2", "-> x.sort()"]),
        ("y = x.reshape(-1, a)", []),
        ("y = np.var(x, ddof=a)", ["-> np.std(x, ddof=a)", "-> np.var(x)"]),
        ("y = np.where(a, b, c)", ["-> np.where(a, c, b)"]),
        ("y = f(side='left')", ["-> f()", "'left' -> 'right'"]),
        ("if a: b()", ["a -> not a", "b() -> pass"]),
        ("if a: raise B", ["a -> not a", "raise B -> pass"]),
        ("[b for b in c if b]", ["b -> not b"]),
        ("while a: break", ["a -> not a", "break -> continue"]),
        ("def f(): return a", ["return a -> return None"]),
        ("def f(a: int | None = b) -> C[1]: ...", []),
        ("def f():\n    'Docstring.'\n    assert a == 1", []),
        ("@cache(maxsize=1)\ndef f(): pass", []),
        ("from a import b\n__all__ = ['b', 1]", []),
        ("a + b  # no mutant: the reason", []),
        ("a + b  # no mutant", ["a + b -> a - b"]),
        ("print('a')", ["print('a') -> pass"]),
    ],
)
def test_faults_are_made_where_code_computes(source: str, expected: list[str]) -> None:
    found = changes(source)
    assert len(found) == len(expected)
    assert all(change.endswith(end) for change, end in zip(found, expected, strict=True)), found


def test_texts_are_changed_where_asked_for() -> None:
    assert changes("a = 'b'") == []
    assert changes("a = 'b'", strings=True) == ["'b' -> 'bXX'"]


def test_every_mutant_compiles_differs_and_has_a_key_of_its_own() -> None:
    mutants = list(mutants_of("module.py", MODULE + "a = 1 + 1\n" + "b = [1, 1]\n"))
    for mutant in mutants:
        compile(mutant.source, "module.py", "exec")
    assert len({mutant.source for mutant in mutants}) == len({mutant.key for mutant in mutants}) == len(mutants)
    assert {mutant.within for mutant in mutants} == {"", "clip", "unused"}


def test_a_long_change_is_cut_to_what_differs() -> None:
    (change, *_) = changes(f"f({'a, ' * 40}b + c, {'d, ' * 40})")[1:]
    assert change == "b + c -> b - c"
    (change, *_) = changes(f"{'a, ' * 40} b if c < d else e")[:1]
    assert change == "c < d -> c <= d"
    (change, *_) = changes(f"(({' + '.join('a' * 60)}) and ({' + '.join('b' * 60)}))")[:1]
    assert len(change) < 170
    assert " and " in change
    assert " or " in change


def small_tree(root: Path) -> None:
    (root / "package").mkdir()
    (root / "package/__init__.py").write_text("", encoding="utf-8")
    (root / "package/module.py").write_text(MODULE, encoding="utf-8")
    (root / "tests").mkdir()
    (root / "tests/test_module.py").write_text(TESTS, encoding="utf-8")
    (root / "pyproject.toml").write_text(
        "[tool.pytest.ini_options]\nmarkers = ['slow: takes long']\n", encoding="utf-8"
    )


def run(root: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "tests.mutation", "package", "--root", str(root), *words],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.mark.slow
def test_a_planted_survivor_is_found_and_covered_faults_are_killed(tmp_path: Path) -> None:
    small_tree(tmp_path)
    (tmp_path / "none.toml").write_text("", encoding="utf-8")
    done = run(
        tmp_path, "--report", str(tmp_path / "r.json"), "--survivors", str(tmp_path / "none.toml"), "--jobs", "2"
    )
    report = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    results = {(mutant["within"], mutant["change"]): mutant["result"] for mutant in report["mutants"]}
    assert results == {
        ("clip", "1 -> 2"): "killed",
        ("clip", "1 -> 0"): "killed",
        ("clip", "x < limit -> x <= limit"): "survived",
        ("clip", "x < limit -> x >= limit"): "killed",
        ("clip", "return x -> return None"): "killed",
        ("clip", "return limit -> return None"): "killed",
        ("unused", "x * 3 -> x / 3"): "survived",
        ("unused", "3 -> 4"): "survived",
        ("unused", "3 -> 2"): "survived",
        ("unused", "return x * 3 -> return None"): "survived",
    }
    assert done.returncode == 1
    assert "SURVIVED package/module.py:20 unused: x * 3 -> x / 3" in done.stdout
    assert done.stdout.splitlines()[-1] == "5 killed, 0 timeout, 5 survived, 0 accepted - 50.0 % killed"
    assert (tmp_path / "package/module.py").read_text(encoding="utf-8") == MODULE


@pytest.mark.slow
def test_accepted_survivors_do_not_count_and_a_fault_that_never_ends_is_stopped(tmp_path: Path) -> None:
    small_tree(tmp_path)
    code = "def count(n: int) -> int:\n    k = n\n    while k:\n        k -= 1\n    return n\n"
    (tmp_path / "package/module.py").write_text(code, encoding="utf-8")
    test = "from package.module import count\ndef test_count():\n    assert count(4) == 4\n"
    (tmp_path / "tests/test_module.py").write_text(test, encoding="utf-8")
    entry = ("[[survivor]]", "file = 'package/module.py'", "within = 'count'", "line = 'while k:'")
    entry += ("change = 'k -> not k'", "reason = 'of another test'")
    (tmp_path / "s.toml").write_text("\n".join(entry), encoding="utf-8")
    done = run(tmp_path, "--survivors", str(tmp_path / "s.toml"), "--limit", "2", "--least", "75")
    assert done.stdout.splitlines()[-1] == "1 killed, 2 timeout, 1 survived, 1 accepted - 75.0 % killed", done.stderr
    assert done.returncode == 0


@pytest.mark.slow
def test_tests_that_fail_without_a_fault_are_said(tmp_path: Path) -> None:
    small_tree(tmp_path)
    (tmp_path / "tests/test_module.py").write_text("def test_no(): assert 0\n", encoding="utf-8")
    done = run(tmp_path)
    assert done.returncode == 2
    assert "package/module.py: exit status 1 without any fault of:\n  tests/test_module.py" in done.stderr


def test_a_modules_tests_are_found(tmp_path: Path) -> None:
    files = ("posecal/metrics/test_metrics.py", "metrics/test_position.py", "other/test_laws.py", "data/test_read.py")
    for file in (*files, "test_imports.py"):
        (tmp_path / "tests" / file).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "tests" / file).write_text("from posecal.engine.registry import x\n", encoding="utf-8")
    assert find_tests("posecal/metrics/position.py", tmp_path) == [
        "tests/metrics/test_position.py",
        "tests/other/test_laws.py",
    ]
    assert find_tests("posecal/read.py", tmp_path) == ["tests/data/test_read.py"]
    assert "tests/test_imports.py" in find_tests("posecal/engine/registry.py", tmp_path)
    with pytest.raises(SystemExit, match=r"^posecal/nothing\.py: no test file of its name or that imports it"):
        find_tests("posecal/nothing.py", tmp_path)


@pytest.mark.slow
def test_the_accepted_survivors_are_still_mutants_and_say_why() -> None:
    accepted = survivors(SURVIVORS)
    assert all(reason.strip() for reason in accepted.values())
    for path in {file for file, *_ in accepted}:
        keys = {mutant.key for mutant in mutants_of(path, (ROOT / path).read_text(encoding="utf-8"), strings=True)}
        assert {key for key in accepted if key[0] == path} <= keys
