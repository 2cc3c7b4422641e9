"""Every example of README and docs runs, word for word, in the order of the pages, as a user would type it."""

import doctest
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = ("start", "file-format", "calibration", "how-sure", "metrics", "report", "recalibrate", "models")


def console_lines(text: str) -> list[str]:
    """The commands of a page: lines that begin with $ in console blocks."""
    blocks = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    return [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ ")]


def pieces(text: str) -> list[tuple[str, str]]:
    """Console and python blocks, in the order in which they stand."""
    return re.findall(r"```(console|python)\n(.*?)```", text, re.DOTALL)


def run(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    program, *words = shlex.split(command)
    module = {"posecal": "posecal", "posecal-models": "posecal_models.cli"}[program]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "MPLBACKEND": "Agg", "COLUMNS": "120"}
    return subprocess.run(
        [sys.executable, "-m", module, *words], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def check_page(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run a page's blocks in order; python examples share their names."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, object] = {}
    tried = 0
    for kind, block in pieces(text):
        if kind == "console":
            for command in console_lines(f"```console\n{block}```"):
                done = run(command, folder)
                assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
                tried += 1
        else:
            example = doctest.DocTestParser().get_doctest(block, names, "page", None, 0)
            runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
            runner.run(example, clear_globs=False)
            names = example.globs
            assert runner.failures == 0
            tried += runner.tries
    return tried


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the world that the pages begin with."""
    folder = tmp_path_factory.mktemp("docs")
    assert run("posecal demo world", folder).returncode == 0
    return folder


@pytest.mark.parametrize("page", PAGES)
def test_a_pages_examples_run_in_order(page: str, world: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8").replace("$ posecal demo world\n", "")
    shutil.copy(world / "world/calibrated.npz", world / "hyps.npz")
    assert check_page(text, world, monkeypatch) > 0


def test_the_readmes_examples_run(world: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(world / "world/calibrated.npz", world / "hyps.npz")
    shutil.copy(world / "world/overconfident.npz", world / "other.npz")
    shutil.copy(world / "world/gt.npz", world / "gt.npz")
    assert check_page((ROOT / "README.md").read_text(encoding="utf-8"), world, monkeypatch) > 8


@pytest.mark.parametrize("page", sorted((ROOT / "docs").glob("*.md")), ids=lambda page: page.stem)
def test_every_picture_and_page_that_is_linked_is_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


def test_readme_has_the_two_commands_that_ci_runs() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for heading in ("Try it", "Test it"):
        block = text.split(f"## {heading}\n")[1].split("```")[1]
        assert len(block.strip().splitlines()) == 2  # the language, and one line


def test_the_readmes_estimator_is_the_one_that_the_models_page_trains() -> None:
    """The page's commands run above; README shows the same ones."""
    readme, page = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/models.md"))
    shown = readme.split("```sh\n")[1].split("```")[0].splitlines()
    assert len(shown) == 5
    assert shown == console_lines(page)[:5]
