"""Entries of a leaderboard: for each evaluated model a TOML file and, beside it, its saved result."""

from __future__ import annotations

import hashlib
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path

from posecal.data.texts import json_text
from posecal.engine.presets import PRESETS
from posecal.engine.storage import load_totals
from posecal.engine.totals import Totals
from posecal.errors import (
    PosecalError,
    PoseFileError,
    attempt,
    did_you_mean,
    option,
    printable,
    raise_all,
    refuse_unreadable,
)
from posecal.metrics.likelihood import MOMENTS
from posecal.stats.same_poses import check_comparable

_SHA256 = re.compile("[0-9a-f]{64}")

Files = dict[str, tuple["Entry", Totals]]
"""Entries and their results, by the names of their files without the ending."""


def _key(about: str, **default: str) -> str:
    return field(metadata={"about": about}, **default)  # type: ignore[call-overload, no-any-return]


@dataclass(frozen=True)
class Entry:
    """What a leaderboard says of a model beside its saved result.

    Attributes
    ----------
    name : str
        The model.
    test_set : str
        What it was evaluated on; models of one test set are compared.
    source : str
        Where the model is found.
    commit : str
        The commit or release of the source.
    command : str
        The commands that made hypotheses and result.
    data : str
        Acknowledgement or licence of the data.
    hypotheses_sha256, result_sha256 : str
        SHA-256 of the file of the hypotheses, which is not kept, and of the saved result.
    preset : str
        The published protocol that it was evaluated by; empty for none.
    """

    name: str = _key("the name of the model")
    test_set: str = _key("the name of what it was evaluated on")
    source: str = _key("where the model is found, such as a repository")
    commit: str = _key("the commit or release of the source")
    command: str = _key("the commands that made hypotheses and result")
    data: str = _key("an acknowledgement or licence of the data")
    hypotheses_sha256: str = _key("the SHA-256 of the file of the hypotheses, 64 digits of 0-9 and a-f")
    result_sha256: str = _key("the SHA-256 of the saved result, 64 digits of 0-9 and a-f")
    preset: str = _key("a name that posecal presets lists", default="")

    @property
    def stem(self) -> str:
        """The name of its files without the ending: letters and digits of its name and its test set."""
        return "-".join(re.findall(r"\w+", f"{self.name} {self.test_set}".lower().replace("_", " ")))

    @property
    def toml(self) -> str:
        """The entry as TOML, text of several lines with its line breaks."""
        values = {key: value for key, value in asdict(self).items() if value}
        return "".join(f"{key} = {_toml(value)}\n" for key, value in values.items())


def _toml(value: str) -> str:
    """Write text as TOML: lines as they are where they can be."""
    lines = value.split("\n")
    if len(lines) == 1:
        return json_text(value)
    if "'''" not in value and value[-1] != "'" and all(map(str.__eq__, lines, map(printable, lines))):
        return f"'''\n{value}'''"
    return '"""\n{}"""'.format("\n".join(json_text(line)[1:-1] for line in lines))


def read_entry(path: Path) -> Entry:
    """Read and check the TOML file of an entry.

    Raises
    ------
    PoseFileError
        For a file that can't be read, and for all keys that are missing, unknown or of another form.
    """
    with refuse_unreadable(path, "no TOML ({})."):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    return checked_entry(table, path.name)


def checked_entry(table: Mapping[str, object], name: str) -> Entry:
    """Make an entry of keys and values; messages begin with the name of its file.

    Raises
    ------
    PoseFileError
        For all keys that are missing, unknown or of another form.
    """
    keys = {key.name: key for key in fields(Entry)}
    problems = [f"{name}: unknown key {key!r}. {did_you_mean(key, keys)}" for key in table if key not in keys]
    for key in keys.values():
        about = key.metadata["about"]
        if key.name not in table:
            if key.default is MISSING:
                problems.append(f"{name}: no {key.name}; expected {about}.")
            continue
        value = table[key.name]
        is_hash = key.name.endswith("_sha256")
        if not isinstance(value, str) or not value.strip() or (is_hash and not _SHA256.fullmatch(value)):
            problems.append(f"{name}: {key.name} is {value!r}; expected {about}.")
        elif value != value.encode(errors="ignore").decode():
            problems.append(f"{name}: {key.name} is {value!r}; expected text in UTF-8.")
        elif key.name == "preset" and value not in PRESETS:
            problems.append(f"{name}: preset {value!r} is not known. {did_you_mean(value, PRESETS)}")
    raise_all(problems, PoseFileError)
    return Entry(**{key: str(value) for key, value in table.items()})


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Give the SHA-256 of a file.

    Raises
    ------
    PoseFileError
        Where it can't be read.
    """
    with refuse_unreadable(path), Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_files(folder: Path) -> tuple[Files, list[str | PosecalError]]:
    """Read all entries of a folder with their results.

    Returns
    -------
    files : dict
        Those that can be read.
    problems : list
        What is wrong with the others; saved results without an entry among them.
    """
    files: Files = {}
    problems: list[str | PosecalError] = []
    entries, results = ({path.stem: path for path in sorted(folder.glob(f"*.{end}"))} for end in ("toml", "npz"))
    for stem, path in entries.items():
        entry = attempt(problems, read_entry, path)
        if stem not in results:
            problems.append(PoseFileError(f"{path.name}: no {stem}.npz beside it; expected its saved result."))
            continue
        totals = attempt(problems, load_totals, results[stem])
        if entry is not None and totals is not None:
            files[stem] = entry, totals
            digest = attempt(problems, sha256_of, results[stem])
            if digest and digest != entry.result_sha256:
                problems.append(
                    f"{stem}.npz: another file than {path.name} says (SHA-256 {digest[:12]}…, there "
                    f"{entry.result_sha256[:12]}…); expected the same. Add the entry again."
                )
    problems += [
        PoseFileError(f"{path.name}: no {stem}.toml beside it; expected one. posecal leaderboard add writes it.")
        for stem, path in results.items()
        if stem not in entries
    ]
    return files, problems


def problems_of(files: Files) -> list[str | PosecalError]:
    """Find what keeps entries from being listed, each by itself and against others of its test set."""
    problems: list[str | PosecalError] = []
    names: dict[tuple[str, str], str] = {}
    test_sets: dict[str, dict[str, Totals]] = {}
    for stem, (entry, totals) in files.items():
        problems += _problems_of_one(stem, entry, totals)
        test_sets.setdefault(entry.test_set, {})[f"{stem}.npz"] = totals
        other = names.setdefault((entry.test_set, entry.name.casefold()), stem)
        if other != stem:
            problems.append(
                f"{other}.toml and {stem}.toml: both are {entry.name!r} on {entry.test_set!r}; expected other names."
            )
    for test_set, results in test_sets.items():
        problems += [
            f"test set {test_set!r}: {refusal.message} Other poses and protocols are another test set."
            for refusal in _unlike_most(results)
        ]
    return problems


def _unlike_most(results: Mapping[str, Totals]) -> list[PosecalError]:
    """Compare results with the first of the largest group of those that can be compared; give the refusals."""
    groups: list[list[str]] = []
    for name in results:
        for group in groups:
            if _refusal(results, group[0], name) is None:
                group.append(name)
                break
        else:
            groups.append([name])
    most = max(groups, key=len)
    refusals = (_refusal(results, most[0], name) for name in results if name not in most)
    return [refusal for refusal in refusals if refusal is not None]


def _refusal(results: Mapping[str, Totals], name: str, other: str) -> PosecalError | None:
    try:
        check_comparable(results[name], results[other], name, other)
    except PosecalError as error:
        return error
    return None


def _problems_of_one(stem: str, entry: Entry, totals: Totals) -> Iterable[str]:
    """Say whether a result was made by another protocol than its entry says, or gives true poses away."""
    used = totals.protocol.options
    wanted = PRESETS[entry.preset].protocol.options if entry.preset else used
    differ = [key for key in used if key != "metrics" and used[key] != wanted[key]]
    if differ:
        options = ", ".join(f"{key}={used[key]} for {wanted[key]}" for key in differ)
        yield f"{stem}.npz: made with {options}; expected those of the preset {entry.preset}, as {stem}.toml says."
    if totals.gallery is not None:
        yield f"{stem}.npz: holds poses for pictures; expected sums alone. {option('gallery', False)} leaves them out."
    d = totals.spec.dimensions or 0
    for name in totals.sums:
        counts = totals.counts[name]
        short = counts[(counts > 0) & (counts <= d)]
        if name.startswith(MOMENTS) and short.size:
            yield (
                f"{stem}.npz: holds means and covariances of the true poses of sequences of {short.min()}, which give "
                f"them away; expected more than d = {d} poses in each, or other {option('metrics')} than nll."
            )
