"""Leaderboards: models that others evaluated, compared by their saved results alone."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from posecal.data.texts import frame_of, json_lines, printable_table
from posecal.data.write import write_file, written_together
from posecal.engine.storage import load_totals
from posecal.engine.totals import Totals
from posecal.errors import PoseDataError, PoseFileError, did_you_mean, for_python, raise_all
from posecal.evaluation.entries import Entry, Files, checked_entry, problems_of, read_files, sha256_of
from posecal.report.comparison import FORMATS, Comparison, best_first, plain
from posecal.report.standings import COLUMNS, standings_rows, standings_sheet

if TYPE_CHECKING:
    import pandas as pd

    from posecal.report.sheet import Sheet


@dataclass(frozen=True)
class Leaderboard:
    """Models on one or more test sets, best first.

    Attributes
    ----------
    entries : mapping of tuples of Entry
        By test set: the models, best first by the first primary metric.
    comparisons : mapping of Comparison
        By test set: the same models with their numbers, intervals, tests and ranks.
    """

    entries: Mapping[str, tuple[Entry, ...]]
    comparisons: Mapping[str, Comparison]

    def __repr__(self) -> str:
        parts = (f"{len(entries)} on {test_set}" for test_set, entries in self.entries.items())
        return f"<Leaderboard: {', '.join(parts)}>"

    def __str__(self) -> str:
        return self.render("text")

    def sheets(self, words: Callable[[str], str] = for_python, *, paper: bool = False) -> list[Sheet]:
        """Lay out the page of each test set, also for a paper; ``words`` says how remarks name options."""
        return [
            standings_sheet(test_set, self.entries[test_set], comparison, words, paper=paper)
            for test_set, comparison in self.comparisons.items()
        ]

    @cached_property
    def table(self) -> pd.DataFrame:
        """A data frame with a row for each test set, metric and model."""
        rows = [row for name, comparison in self.comparisons.items() for row in standings_rows(name, comparison)]
        return frame_of([tuple(row.values()) for row in rows], COLUMNS)

    def render(
        self, form: str, *, width: int = 120, colour: bool = False, words: Callable[[str], str] = for_python
    ) -> str:
        """Write the leaderboard.

        Parameters
        ----------
        form : str
            ``text``, ``markdown`` or ``latex``: a page for each test set. ``csv``: :attr:`table`. ``json``: entries,
            all numbers and all differences of each test set.
        width, colour
            Of the terminal, for ``text``.
        words : callable
            How remarks name options: ``for_python`` or ``for_command_line`` of :mod:`posecal.errors`.

        Raises
        ------
        PoseDataError
            For another form.
        """
        if form == "csv":
            nothing = [None] * (len(COLUMNS) - 3)
            notes = [(name, text, "remark", *nothing) for name, text in self._remarks(words)]
            table = frame_of([*self.table.itertuples(index=False, name=None), *notes], COLUMNS)
            return printable_table(table).to_csv(index=False, lineterminator="\n").rstrip("\n")
        if form == "json":
            return json_lines(self._as_dict(words))
        if form == "text":
            return "\n\n\n".join(sheet.text(width=width, colour=colour) for sheet in self.sheets(words))
        if form not in {"markdown", "latex"}:
            raise PoseDataError(f"format: {form!r} is not known. {did_you_mean(form, FORMATS)}")
        return "\n\n".join(getattr(sheet, form)() for sheet in self.sheets(words, paper=form == "latex"))

    def _remarks(self, words: Callable[[str], str]) -> Iterator[tuple[str, str]]:
        for test_set, comparison in self.comparisons.items():
            yield from ((test_set, remark) for remark in comparison.remarks_in(words))

    def _as_dict(self, words: Callable[[str], str]) -> dict[str, object]:
        """Give all rows as lists of dictionaries, for JSON."""
        differences = (
            {"test_set": test_set, **asdict(one)}
            for test_set, comparison in self.comparisons.items()
            for one in comparison.differences
        )
        return {
            "signatures": {name: comparison.totals[0].signature for name, comparison in self.comparisons.items()},
            "primary": {name: comparison.primary for name, comparison in self.comparisons.items()},
            "remarks": [{"test_set": name, "remark": remark} for name, remark in self._remarks(words)],
            "entries": [asdict(entry) for entries in self.entries.values() for entry in entries],
            "values": [{key: plain(value) for key, value in row.items()} for row in self.table.to_dict("records")],
            "differences": [{key: plain(value) for key, value in row.items()} for row in differences],
        }


def leaderboard(folder: str | os.PathLike[str] = ".") -> Leaderboard:
    """Compare the models of a folder by their saved results, without hypotheses or true poses.

    Parameters
    ----------
    folder : path
        It holds an entry for each model: a TOML file, and a result of ``evaluate --save`` of the same name with the
        ending ``.npz``. :func:`add_entry` writes both.

    Returns
    -------
    Leaderboard
        The models of each test set, best first.

    Raises
    ------
    PoseFileError, PoseDataError
        Where there are no entries, and for everything that is wrong with them at once: files that are missing, damaged
        or not those of their entry, unknown and missing keys, results that were made by other options than their entry
        or the other models of the test set, or on other poses.
    """
    files, problems = read_files(_existing(folder))
    raise_all([*problems, *problems_of(files)])
    if not files:
        raise PoseFileError(
            f"{folder}: no entries; expected a .toml and a .npz of each model. posecal leaderboard add writes them."
        )
    return _leaderboard(files)


def _leaderboard(files: Files) -> Leaderboard:
    groups: dict[str, dict[str, tuple[Entry, Totals]]] = {}
    for entry, totals in files.values():
        groups.setdefault(entry.test_set, {})[entry.name] = entry, totals
    comparisons = {name: _best_first({m: t for m, (_, t) in models.items()}) for name, models in sorted(groups.items())}
    entries = {
        name: tuple(groups[name][model][0] for model in comparison.names) for name, comparison in comparisons.items()
    }
    return Leaderboard(entries, comparisons)


def _best_first(models: Mapping[str, Totals]) -> Comparison:
    """Compare models in the order of the first primary metric."""
    unsorted = Comparison(tuple(models), tuple(models.values()))
    names = best_first(unsorted, unsorted.metrics[unsorted.primary[0]])
    return Comparison(tuple(names), tuple(models[name] for name in names))


def add_entry(
    folder: str | os.PathLike[str],
    result: str | os.PathLike[str],
    *,
    name: str,
    test_set: str,
    source: str,
    commit: str,
    command: str | Sequence[str],
    data: str,
    hypotheses: str | os.PathLike[str],
    preset: str = "",
) -> Path:
    """Add a model to a leaderboard, or replace its entry: check all, then write its TOML file and a copy of its result.

    Parameters
    ----------
    folder : path
        The leaderboard; made if only the folder that it lies in exists.
    result : path
        The saved result.
    name, test_set : str
        Of the model, and of what it was evaluated on. An entry of the same two is replaced.
    source, commit : str
        Where the model is found, and its commit or release there.
    command : str or sequence of str
        The commands that made hypotheses and result.
    data : str
        Acknowledgement or licence of the data.
    hypotheses : path
        The hypotheses, of which only the SHA-256 is kept.
    preset : str
        The published protocol that the result was made by; none by default.

    Returns
    -------
    Path
        The TOML file.

    Raises
    ------
    PoseFileError, PoseDataError
        For everything that is wrong with the entry, or with those that are there, at once. Then nothing is written.
    """
    folder = Path(folder)
    is_new = not folder.exists()
    table = {
        "name": name,
        "test_set": test_set,
        "source": source,
        "commit": commit,
        "command": command if isinstance(command, str) else "\n".join(command),
        "data": data,
        "hypotheses_sha256": sha256_of(hypotheses),
        "result_sha256": sha256_of(result),
        **({"preset": preset} if preset else {}),
    }
    entry = checked_entry(table, "entry")
    totals, copy = load_totals(result), Path(result).read_bytes()
    files, problems = ({}, []) if is_new else read_files(_existing(folder))
    path = folder / f"{entry.stem}.toml"
    there = files.get(entry.stem)
    if there and (there[0].name, there[0].test_set) != (name, test_set):
        problems.append(
            f"{path.name}: is the entry of {there[0].name!r} on {there[0].test_set!r}; expected a name that differs in "
            "letters or digits."
        )
    files[entry.stem] = entry, totals
    raise_all([*problems, *problems_of(files)])
    if is_new:
        try:
            folder.mkdir()
        except OSError as error:
            raise PoseFileError(f"{folder}: can't be made ({error.strerror}).") from None
    with written_together():
        write_file(path.with_suffix(".npz"), lambda file: file.write(copy))
        write_file(path, lambda file: file.write(entry.toml.encode()))
    return path


def _existing(folder: str | os.PathLike[str]) -> Path:
    path = Path(folder)
    if not path.is_dir():
        what = "is no folder" if path.exists() else "no such folder"
        raise PoseFileError(f"{path}: {what}; expected the folder of a leaderboard.")
    return path
