"""Importing brings nothing that is not used, arrows between modules point down, and every public name is documented."""

import ast
import importlib
import inspect
import os
import pkgutil
import subprocess
import sys
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
    calls += ["plot/poses/--help", "compare/--help", "recalibrate/fit/--help", "presets/--help", "demo/--help"]
    assert python(code, tmp_path, *calls).stderr == "[]\n"


def test_every_name_is_loaded_when_it_is_used() -> None:
    assert dir(posecal) == sorted([*posecal.__all__, "__version__"])
    for name in posecal.__all__:
        assert getattr(posecal, name) is getattr(posecal, name)


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match=r"^module 'posecal' has no attribute 'evaluat'$"):
        posecal.evaluat  # noqa: B018


# --- arrows ---------------------------------------------------------------------------------------------------

FLOORS = (
    "errors",
    "units skeleton threads arrays layout file_array archive tables numbers writing",
    "box",
    "block",
    "blocks",
    "align pairs",
    "io sanity cells declared",
    "joining metrics.best_of",
    "metrics.position metrics.spread metrics.guide calibration.ranks",
    "metrics.pck metrics.proper metrics.velocity calibration.curve calibration.battery",
    "metrics calibration.error inference",
    "calibration.floor protocol",
    "calibration metric",
    "metrics.table metrics.score_table calibration.table occlusion",
    "registry totals",
    "leave_one_out results shards",
    "sureness",
    "rows summation",
    "findings comparison reference explanation",
    "conclusion recalibration.folds",
    "recalibration.spread recalibration.radius",
    "recalibration.maps",
    "recalibration",
    "sheets.report sheets.presets sheets.comparison sheets.recalibration",
    "sheets",
    "report",
    "evaluation",
    "plot.style",
    "plot.battery plot.body plot.comparison plot.curves",
    "plot",
    "html demo",
    "cli.options cli.running",
    "cli.compare cli.evaluate cli.plots cli.recalibrate",
    "cli",
    "__main__",
)
"""The rooms of docs/design.md in full: a module imports from floors below its own, or beside it without a circle."""


def modules(package: str) -> Iterator[tuple[str, Path]]:
    """Every module of a package, by its name."""
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


MODULES = dict(modules("posecal"))


def imports(path: Path) -> set[str]:
    """Every module that a file imports, within functions too; not those that only types need."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            node.body.clear()
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in MODULES else node.module for name in names}
    return found


ARROWS = {
    name.removeprefix("posecal."): {
        target.removeprefix("posecal.") for target in imports(path) if target in MODULES and target != "posecal"
    }
    for name, path in MODULES.items()
    if name != "posecal"
}
FLOOR_OF = {name: number for number, floor in enumerate(FLOORS) for name in floor.split()}


def below(name: str) -> set[str]:
    """Everything that a module imports, and what that imports."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        here = waiting.pop()
        for target in ARROWS[here] - found:
            found.add(target)
            waiting.append(target)
    return found


def test_every_module_has_its_floor() -> None:
    assert set(ARROWS) == set(FLOOR_OF)


@pytest.mark.parametrize("name", ARROWS)
def test_arrows_point_down(name: str) -> None:
    assert {target for target in ARROWS[name] if FLOOR_OF[target] > FLOOR_OF[name]} == set()


@pytest.mark.parametrize("name", ARROWS)
def test_no_module_needs_itself(name: str) -> None:
    assert name not in below(name)


@pytest.mark.parametrize("room", ["metrics", "calibration"])
def test_functions_of_arrays_know_no_files_reports_or_pictures(room: str) -> None:
    allowed = {"errors", "arrays", "box", "block", "blocks", "align"}
    foreign = {name for name in below(room) if name.partition(".")[0] not in {*allowed, "metrics", "calibration"}}
    assert foreign == set()


def test_only_the_module_that_runs_imports_the_command_line() -> None:
    importing = {name for name, targets in ARROWS.items() if any(t.partition(".")[0] == "cli" for t in targets)}
    assert {name for name in importing if not name.startswith("cli")} == {"__main__"}


@pytest.mark.parametrize("name", MODULES)
def test_the_core_imports_neither_models_nor_toy(name: str) -> None:
    assert not {target.partition(".")[0] for target in imports(MODULES[name])} & {"posecal_models", "toy", "torch"}


def test_pictures_compute_nothing() -> None:
    """Of the rooms that compute, pictures take types and constants only."""
    taken = {}
    for name, path in MODULES.items():
        if name.startswith("posecal.plot"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ImportFrom) and node.module is not None:
                    room = node.module.removeprefix("posecal.").partition(".")[0]
                    if room in {"metrics", "calibration", "inference", "totals", "sureness"}:
                        home = importlib.import_module(node.module)
                        taken |= {alias.name: getattr(home, alias.name) for alias in node.names}
    assert "DEFINITIONS" in taken
    assert [name for name, found in taken.items() if inspect.isfunction(found)] == []


# --- documentation --------------------------------------------------------------------------------------------

ROOMS = (posecal, posecal.metrics, posecal.calibration, posecal.plot)
FUNCTIONS = {
    f"{room.__name__}.{name}": inspect.unwrap(getattr(room, name))
    for room in ROOMS
    for name in room.__all__
    if inspect.isroutine(inspect.unwrap(getattr(room, name)))
}
CLASSES = {
    f"{room.__name__}.{name}": getattr(room, name)
    for room in ROOMS
    for name in room.__all__
    if inspect.isclass(getattr(room, name)) and inspect.unwrap(getattr(room, name)).__module__.startswith("posecal")
}
NUMERIC = sorted(name for name in FUNCTIONS if name.startswith(("posecal.metrics", "posecal.calibration")))


def documented(section: NumpyDocString, part: str) -> set[str]:
    """The names that a section of a docstring describes."""
    return {word.strip() for entry in section[part] for word in entry.name.split(",")}


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
    obvious = {"path", "figure", "report", "comparison", "pairs", "text", "some", "suffix"}  # one sentence says it all
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
        assert {key for key, entry in fields.items() if "about" not in entry.metadata} <= documented(
            doc, "Attributes"
        ) | documented(doc, "Parameters")


@pytest.mark.parametrize("name", [name for name in MODULES if name != "posecal.__main__"])
def test_all_is_true(name: str) -> None:
    module = importlib.import_module(name)
    assert sorted(set(module.__all__)) == sorted(module.__all__)
    for public in module.__all__:
        assert getattr(module, public) is not None


def test_every_module_of_the_package_says_which_question_it_answers() -> None:
    for found in pkgutil.walk_packages(posecal.__path__, "posecal."):
        if found.name != "posecal.__main__":
            assert len(importlib.import_module(found.name).__doc__ or "") > 30, found.name
