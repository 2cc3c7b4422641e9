"""Every example of README and docs runs, word for word, in the order of the pages, as a user would type it."""

import doctest
import re
import shlex
import shutil
import textwrap
from contextlib import chdir
from pathlib import Path
from runpy import run_path

import pytest
from click.testing import Result
from typer.testing import CliRunner

import posecal
import posecal.cli
import posecal_models.cli
from tests.test_structure import PRIVATE_WORDS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = (
    *("start", "file-format", "convert", "joints", "calibration", "how-sure", "metrics", "report", "figures"),
    *(
        "recalibrate",
        "likelihood",
        "joint-angles",
        "training-loop",
        "scale",
        "own-metric",
        "models",
        "leaderboard",
        "motion",
    ),
)


def console_lines(text: str) -> list[str]:
    """The commands of a page: lines that begin with $ in console blocks."""
    blocks = re.findall(r"```console\n(.*?)```", text, re.DOTALL)
    return [line[2:] for block in blocks for line in block.splitlines() if line.startswith("$ ")]


def pieces(text: str) -> list[tuple[str, str]]:
    """Console and python blocks, in the order in which they stand."""
    return re.findall(r"```(console|python)\n(.*?)```", text, re.DOTALL)


def run(command: str, columns: int = 120) -> Result:
    """Run a command of a page in this process, in the current folder."""
    program, *words = shlex.split(command)
    app = {"posecal": posecal.cli.app, "posecal-models": posecal_models.cli.app}[program]
    done = CliRunner().invoke(app, words, prog_name=program, env={"COLUMNS": str(columns)})
    assert done.exit_code == 0, f"{command}\n{done.output}\n{done.exception!r}"
    return done


def check_page(text: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> int:
    """Run a page's blocks in order; python examples share their names."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    names: dict[str, object] = {}
    tried = 0
    for kind, block in pieces(text):
        if kind == "console":
            for command in console_lines(f"```console\n{block}```"):
                run(command)
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
    with chdir(folder):
        run("posecal demo world")
    return folder


@pytest.mark.slow
@pytest.mark.usefixtures("nothing_stays_registered")
@pytest.mark.parametrize("page", PAGES)
def test_a_pages_examples_run_in_order(page: str, world: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8").replace("$ posecal demo world\n", "")
    shutil.copy(world / "world/calibrated.npz", world / "hyps.npz")
    assert check_page(text, world, monkeypatch) > 0


@pytest.mark.slow
@pytest.mark.parametrize("page", ["joint-angles", "motion"])
def test_the_first_report_of_a_page_is_what_is_printed(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    data, rest = text.split("```console\n$ ", 1)
    assert check_page(data, tmp_path, monkeypatch) > 5
    command, after = rest.split("\n```", 1)
    shown = after.split("```text\n")[1].split("\n```")[0]
    printed = run(command, columns=100).stdout.split("\nsignature:")[0]
    assert [line.rstrip() for line in printed.splitlines()] == shown.splitlines()


@pytest.mark.slow
def test_the_readmes_examples_run(world: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copy(world / "world/calibrated.npz", world / "hyps.npz")
    shutil.copy(world / "world/overconfident.npz", world / "other.npz")
    shutil.copy(world / "world/gt.npz", world / "gt.npz")
    assert check_page((ROOT / "README.md").read_text(encoding="utf-8"), world, monkeypatch) > 8


ALL_PAGES = pytest.mark.parametrize(
    "page", [*sorted(DOCS.glob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=lambda page: page.stem
)


@ALL_PAGES
def test_every_picture_and_page_that_is_linked_is_there(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target


@ALL_PAGES
def test_words_are_those_of_the_field(page: Path) -> None:
    assert PRIVATE_WORDS.findall(page.read_text(encoding="utf-8")) == []


@ALL_PAGES
def test_no_heading_is_a_question(page: Path) -> None:
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    headings = re.findall(r"^#+ (.*)", text, re.MULTILINE)
    assert [heading for heading in headings if "?" in heading] == []


def test_the_loop_in_two_processes_is_the_one_that_its_test_runs() -> None:
    helper = (ROOT / "tests/helpers/two_ranks.py").read_text(encoding="utf-8")
    code = textwrap.dedent(helper.split("# docs: begin\n")[1].split("    # docs: end")[0])
    assert f"```py\n{code}```" in (DOCS / "training-loop.md").read_text(encoding="utf-8")


def test_every_page_is_in_the_index() -> None:
    listed = re.findall(r"^[a-z-]+$", (DOCS / "index.md").read_text(encoding="utf-8"), re.MULTILINE)
    pages = [*DOCS.glob("*.md"), *DOCS.glob("*.ipynb")]
    assert sorted([*listed, "index"]) == sorted(page.stem for page in pages)


@pytest.mark.slow
def test_the_page_of_commands_shows_what_they_print() -> None:
    page = (DOCS / "commands.md").read_text(encoding="utf-8")
    with_output = run_path(str(DOCS / "generate.py"))["with_output"]
    assert with_output(page).splitlines() == page.splitlines(), "run python docs/generate.py commands"


def test_the_glossary_names_the_headline_metrics() -> None:
    page = (DOCS / "glossary.md").read_text(encoding="utf-8")
    headings = re.findall(r"^([^ `#\n].*)$", page.split("{glossary}")[1], re.MULTILINE)
    terms = {term for heading in headings for term in heading.split(", ")}
    assert {"minMPJPE", "MPJPE", "PCK", "AUC of PCK", "CPS", "ECE", "signed area", "energy score", "NLL"} <= terms


def test_every_public_name_is_on_the_page_of_public_names() -> None:
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    shown = {name.rpartition(".")[2] for name in re.findall(r"(?:::|^  ) ([\w.]+)$", text, re.MULTILINE)}
    shown |= set(re.findall(r"``(\w+)`` is their type", text))
    packages = (posecal, posecal.metrics, posecal.calibration, posecal.recalibration, posecal.plot)
    assert {name for package in packages for name in package.__all__} - shown == set()


def test_the_tree_of_the_architecture_page_is_that_of_the_package() -> None:
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    folders: list[str] = []
    listed: list[str] = []
    for line in page.split("```text\n")[1].split("```")[0].splitlines():
        folders = folders[: (len(line) - len(line.lstrip())) // 2]
        words = line.split()
        if words[0].endswith("/"):
            folders.append(words[0])
        listed += ["".join([*folders, word]) for word in words if word.endswith(".py")]
    packages = [ROOT / "posecal", ROOT / "posecal_models"]
    files = {path.relative_to(ROOT).as_posix() for package in packages for path in package.rglob("*.py")}
    modules = {file for file in files if file == "posecal/__init__.py" or not file.endswith("/__init__.py")}
    assert sorted(listed) == sorted(modules)


def test_readme_has_the_two_commands_that_ci_runs() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for heading in ("Try it", "Test it"):
        block = text.split(f"## {heading}\n")[1].split("```")[1]
        assert len(block.strip().splitlines()) == 2  # the language, and one line


def test_the_readmes_estimator_is_the_one_that_the_models_page_samples() -> None:
    """The page's commands run above; README shows the same ones."""
    readme, page = ((ROOT / name).read_text(encoding="utf-8") for name in ("README.md", "docs/models.md"))
    shown = readme.split("```sh\n")[1].split("```")[0].splitlines()
    assert len(shown) == 5
    assert shown == console_lines(page)[:5]
