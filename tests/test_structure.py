"""Imports bring nothing that is not used and keep to their layers; every public name is documented."""

import ast
import importlib
import inspect
import os
import re
import subprocess
import sys
import tomllib
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from numpydoc.docscrape import ClassDoc, FunctionDoc, NumpyDocString

import posecal

ROOT = Path(__file__).parents[1]
HEAVY = ("torch", "pandas", "matplotlib", "scipy", "jinja2", "rich", "typer", "click")


def python(code: str, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run code in a fresh interpreter and an empty folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", "COLUMNS": "100"}
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)


def brought(code: str, folder: Path) -> set[str]:
    """The top-level packages that are loaded after some code."""
    report = "import sys; print(*{name.partition('.')[0] for name in sys.modules})"
    return set(python(f"{code}\n{report}", folder).stdout.splitlines()[-1].split())


# --- importing ------------------------------------------------------------------------------------------------


def test_importing_brings_nothing_heavy(tmp_path: Path) -> None:
    assert not brought("import posecal", tmp_path) & {*HEAVY, "numpy"}


def test_the_functions_of_arrays_bring_no_tables_pictures_or_command_line(tmp_path: Path) -> None:
    found = brought("import posecal; posecal.metrics.min_mpjpe; posecal.calibration.ece", tmp_path)
    assert not found & set(HEAVY)
    assert "numpy" in found


def test_what_is_brought_would_be_noticed(tmp_path: Path) -> None:
    assert {"numpy", "jinja2"} <= brought("import posecal, numpy, jinja2", tmp_path)


def test_importing_says_and_writes_nothing(tmp_path: Path) -> None:
    done = python("import posecal", tmp_path)
    assert (done.stdout, done.stderr, list(tmp_path.iterdir())) == ("", "", [])


def test_help_and_version_bring_no_numpy(tmp_path: Path) -> None:
    code = (
        "from posecal.cli import app\n"
        "import sys\n"
        "for call in sys.argv[1:]:\n"
        "    try: app(call.split('/'), prog_name='posecal')\n"
        "    except SystemExit as end: assert end.code in (0, None), call\n"
        "found = sorted({'numpy', 'scipy', 'pandas', 'matplotlib', 'torch', 'jinja2'} & set(sys.modules))\n"
        "print(found, file=sys.stderr)"
    )
    calls = ["--help", "--version", "evaluate/--help", "report/--help", "merge/--help", "plot/--help"]
    calls += ["leaderboard/--help", "leaderboard/add/--help"]
    calls += ["plot/poses/--help", "compare/--help", "recalibrate/fit/--help", "presets/--help", "demo/--help"]
    assert python(code, tmp_path, *calls).stderr == "[]\n"


def test_every_name_is_loaded_when_it_is_used() -> None:
    assert dir(posecal) == sorted([*posecal.__all__, "__version__"])
    for name in posecal.__all__:
        assert getattr(posecal, name) is getattr(posecal, name)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"^module 'posecal' has no attribute 'evaluat'$"):
        posecal.evaluat  # noqa: B018


# --- layers ---------------------------------------------------------------------------------------------------


def modules(package: str) -> dict[str, Path]:
    """Every module of a package, by its name."""
    paths = sorted((ROOT / package).rglob("*.py"))
    parts = {path: path.relative_to(ROOT).with_suffix("").parts for path in paths}
    return {".".join(p[:-1] if p[-1] == "__init__" else p): path for path, p in parts.items()}


MODULES = modules("posecal")


def test_imports_keep_to_the_layers_of_pyproject() -> None:
    program = Path(sys.executable).with_name("lint-imports")
    done = subprocess.run([program], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert "0 broken" in done.stdout


def test_every_package_and_module_of_the_top_level_is_in_a_layer() -> None:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = set(contracts[0]["layers"])
    top = {path.stem if path.is_file() else path.name for path in (ROOT / "posecal").iterdir()}
    assert top - {"__init__", "__main__", "__pycache__", "py"} == layers
    assert len(top - {"__pycache__", "py"}) <= 18


def test_no_module_is_longer_than_one_idea() -> None:
    long = {name: len(path.read_text().splitlines()) for name, path in MODULES.items()}
    assert {name: lines for name, lines in long.items() if lines > 380} == {}


def test_figures_compute_nothing() -> None:
    """Of the packages that compute, figures take types and constants only."""
    names = {}
    for name, path in MODULES.items():
        if name.startswith("posecal.plot"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[1:2] in (
                    ["metrics"],
                    ["calibration"],
                    ["stats"],
                    ["engine"],
                ):
                    home = importlib.import_module(str(node.module))
                    names |= {alias.name: getattr(home, alias.name) for alias in node.names}
    assert "DEFINITIONS" in names
    assert [name for name, value in names.items() if inspect.isfunction(value)] == []


# --- documentation --------------------------------------------------------------------------------------------

PUBLIC = (posecal, posecal.metrics, posecal.calibration, posecal.recalibration, posecal.plot)
FUNCTIONS = {
    f"{package.__name__}.{name}": inspect.unwrap(getattr(package, name))
    for package in PUBLIC
    for name in package.__all__
    if inspect.isroutine(inspect.unwrap(getattr(package, name)))
}
CLASSES = {
    f"{package.__name__}.{name}": getattr(package, name)
    for package in PUBLIC
    for name in package.__all__
    if inspect.isclass(getattr(package, name))
    and inspect.unwrap(getattr(package, name)).__module__.startswith("posecal")
}
NUMERIC = sorted(name for name in FUNCTIONS if name.startswith(("posecal.metrics", "posecal.calibration")))


def documented(section: NumpyDocString, part: str) -> set[str]:
    """The names that a section of a docstring describes."""
    return {word.strip(" *") for entry in section[part] for word in entry.name.split(",")}


@pytest.fixture(autouse=True)
def _unknown_sections_are_errors() -> Iterator[None]:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_public_function_documents_what_goes_in_and_comes_out(name: str) -> None:
    function = FUNCTIONS[name]
    doc = FunctionDoc(function)
    assert " ".join(doc["Summary"]).endswith(".")
    taken = set(inspect.signature(function).parameters)
    described = documented(doc, "Parameters")
    obvious = {
        "path",
        "figure",
        "report",
        "comparison",
        "data",
        "text",
        "some",
        "suffix",
        "map_",
    }  # one sentence says it all
    assert described <= taken
    assert taken - described <= (set() if described else obvious)
    if described:
        nothing = inspect.signature(function).return_annotation in {None, "None"}
        assert bool(doc["Returns"]) is not nothing


@pytest.mark.parametrize("name", sorted(FUNCTIONS))
def test_a_public_function_that_refuses_says_so(name: str) -> None:
    function = FUNCTIONS[name]
    raising = any(isinstance(node, ast.Raise) for node in ast.walk(ast.parse(inspect.getsource(function).strip())))
    if raising:
        assert FunctionDoc(function)["Raises"]


@pytest.mark.parametrize("name", NUMERIC)
def test_a_metric_says_in_what_it_differs_from_the_published_code_and_shows_an_example(name: str) -> None:
    doc = FunctionDoc(FUNCTIONS[name])
    assert "Differs from the published code: " in " ".join(doc["Notes"])
    assert any(line.startswith(">>>") for line in doc["Examples"])


@pytest.mark.parametrize("name", NUMERIC)
def test_a_metric_takes_data_by_position_and_options_by_name(name: str) -> None:
    taken = inspect.signature(FUNCTIONS[name]).parameters
    assert inspect.Parameter.VAR_KEYWORD not in {parameter.kind for parameter in taken.values()}
    if "hypotheses" in taken:
        assert list(taken)[:2] == ["hypotheses", "truth"]
        assert {taken[name].kind for name in ("hypotheses", "truth")} == {inspect.Parameter.POSITIONAL_ONLY}
        optional = [parameter for parameter in taken.values() if parameter.default is not inspect.Parameter.empty]
        assert {parameter.kind for parameter in optional} == {inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize("name", sorted(CLASSES))
def test_a_public_class_and_its_methods_are_documented(name: str) -> None:
    found = CLASSES[name]
    doc = ClassDoc(found)
    assert " ".join(doc["Summary"]).endswith(".")
    own = [entry for key, entry in vars(found).items() if not key.startswith("_") and inspect.isroutine(entry)]
    for method in own:
        assert inspect.getdoc(method), f"{name}.{method}"
    if not issubclass(found, Exception):
        fields = getattr(found, "__dataclass_fields__", {})
        assert {
            key for key, entry in fields.items() if "about" not in entry.metadata and not key.startswith("_")
        } <= documented(doc, "Attributes") | documented(doc, "Parameters")


@pytest.mark.parametrize("name", [name for name in MODULES if name != "posecal.__main__"])
def test_a_module_says_what_it_holds_in_its_first_line(name: str) -> None:
    if name == "posecal.torch":
        pytest.importorskip("torchmetrics")
    module = importlib.import_module(name)
    first = (module.__doc__ or "").partition("\n")[0]
    assert len(first) > 12
    assert "?" not in first
    assert first.rstrip().endswith((".", ":"))


PRIVATE_WORDS = re.compile(
    r"\b(sights?|sureness|voices|seats|hears?|heard|silence|told|house|worth|doubts?|held_against|add_up)\b",
    re.IGNORECASE,
)


@pytest.mark.parametrize("package", ["posecal", "posecal_models", "toy"])
def test_words_are_those_of_the_field(package: str) -> None:
    found = {name: PRIVATE_WORDS.findall(path.read_text(encoding="utf-8")) for name, path in modules(package).items()}
    assert {name: words for name, words in found.items() if words} == {}
