"""Tasks, each in an environment of its own: ``nox --list``, ``nox -s NAME -- arguments``."""

from __future__ import annotations

import re
from pathlib import Path

import nox

nox.options.sessions = ["lint", "types", "tests"]
nox.options.default_venv_backend = "venv"

PYPROJECT = nox.project.load_toml("pyproject.toml")
PROJECT = PYPROJECT["project"]
PYTHONS = nox.project.python_versions(PYPROJECT)
NOT_LOWEST = (
    *("posecal", "torch", "torchmetrics", "safetensors"),
    *("mypy", "ruff", "pandas-stubs", "scipy-stubs", "import-linter"),
)
"""Left out of the lowest versions: PyTorch and what needs it, for its size, and what only reads code."""
WITH_LOWEST = ["cli", "data", "plot", "report", "stats", "test_laws.py"]
"""Tests in which libraries are called: all metrics by the laws; the others call posecal's own functions, or PyTorch."""


OLD_WARNINGS = ("-W", "ignore::DeprecationWarning", "-W", "ignore::PendingDeprecationWarning")
"""Old libraries call what newer ones have deprecated; that is no fault of posecal."""


def name_of(requirement: str) -> str:
    """Name of a package in a requirement."""
    return re.split(r"[^\w.-]", requirement, maxsplit=1)[0]


def lowest_versions() -> list[str]:
    """Every dependency at the lower bound of pyproject.toml."""
    extras = PROJECT["optional-dependencies"]
    lines = [*PROJECT["dependencies"], *extras["h36m"], *extras["test"]]
    lines = [line for line in lines if name_of(line) not in NOT_LOWEST]
    unbounded = [line for line in lines if ">=" not in line]
    if unbounded:
        raise ValueError(f"pyproject.toml: {', '.join(unbounded)}; expected a lower bound, NAME>=VERSION.")
    return [re.sub(r"\s*>=\s*([\w.]+).*", r"==\1", line) for line in lines]


def install_tools(session: nox.Session, *names: str) -> None:
    """Install tools of the test extra, within its bounds and the constraints."""
    lines = [line for line in PROJECT["optional-dependencies"]["test"] if name_of(line) in names]
    session.install("-c", "constraints.txt", *lines)


def install_all(session: nox.Session) -> None:
    """Install posecal and everything that its tests need, in the newest versions."""
    session.install("-c", "constraints.txt", "-e", ".[test]")


@nox.session(python=PYTHONS)
def tests(session: nox.Session) -> None:
    """All tests, newest dependencies, each Python that is found."""
    install_all(session)
    session.run("python", "-m", "pytest", "-q", *(session.posargs or ["-n", "auto", "--dist", "worksteal"]))


@nox.session(python=PYTHONS[0])
def lowest(session: nox.Session) -> None:
    """Quick tests that need no PyTorch: oldest Python, each dependency at its lower bound."""
    versions = lowest_versions()
    constraints = Path(session.create_tmp(), "constraints-lowest.txt")
    constraints.write_text("\n".join(versions) + "\n", encoding="utf-8")
    session.install("-c", str(constraints), "-e", ".", *versions)
    quick = ["-n", "auto", "--dist", "worksteal", "-m", "not slow", "posecal", "--ignore=posecal/torch.py"]
    what = session.posargs or [*quick, *(f"tests/{name}" for name in WITH_LOWEST)]
    session.run("python", "-m", "pytest", "-q", *OLD_WARNINGS, *what)


@nox.session
def lint(session: nox.Session) -> None:
    """Style, format, and which packages may import which."""
    install_tools(session, "ruff", "import-linter")
    session.run("ruff", "check", *(session.posargs or ["."]))
    session.run("ruff", "format", "--check", *(session.posargs or ["."]))
    session.run("lint-imports")


@nox.session
def types(session: nox.Session) -> None:
    """Types."""
    install_all(session)
    session.run("mypy", *session.posargs)


@nox.session(venv_backend="none")
def page(session: nox.Session) -> None:
    """Lint and format of the page's scripts and styles, by Biome; needs npm."""
    session.run("npm", "ci", "--no-audit", "--no-fund", external=True)
    session.run("npm", "run", "check", external=True)


@nox.session
def docs(session: nox.Session) -> None:
    """The documentation, into docs/_build/html."""
    session.install("-c", "constraints.txt", "-e", ".[docs,models,torch]")
    session.run("sphinx-build", "-W", "-n", "-b", "html", *session.posargs, "docs", "docs/_build/html")


@nox.session
def mutation(session: nox.Session) -> None:
    """Mutation testing of the modules given: ``nox -s mutation -- posecal/metrics --sample 40``."""
    install_all(session)
    session.run("python", "-m", "tests.mutation", *(session.posargs or ["posecal/metrics", "--sample", "40"]))
