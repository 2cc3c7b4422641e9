"""What does the benchmark leave behind? The table, the numbers as JSON, a result of each model that ``posecal compare``
and ``posecal report`` read, and the paper's pictures, in one folder.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from posecal.data.write import write_file
from posecal.errors import PoseDataError, PoseFileError
from posecal.plot import save
from posecal_models import pictures
from posecal_models.benchmark import Judged, held_out_poses, hypotheses_of, judge, markdown
from posecal_models.cgnf.model import CGNF
from posecal_models.checkpoint import load_estimator, notes_of
from posecal_models.contract import Context
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.training_set import seeded
from posecal_models.progress import counted
from posecal_models.sample import check_suits

__all__ = ["run_benchmark", "seen_in_training"]

_SHOWN = 7


def run_benchmark(
    data: Path,
    models: dict[str, str],
    subjects: list[str],
    folder: Path,
    *,
    n: int = 200,
    every: int = 16,
    seeds: int = 3,
) -> str:
    """Judge estimators and write everything into a folder.

    Parameters
    ----------
    data : Path
        Motion capture.
    models : dict of str to str
        Weights by the names of the rows.
    subjects : list of str
        Test subjects.
    folder : Path
        It is made if its parent is there.
    n, every, seeds : int
        Hypotheses, frames and sampling seeds.

    Returns
    -------
    str
        The table in Markdown.

    Raises
    ------
    PoseFileError, PoseDataError
        Where something does not fit.
    """
    stems = [_stem(name) for name in models]
    if alike := [name for name in models if not _stem(name) or stems.count(_stem(name)) > 1]:
        raise PoseDataError(
            f"models: {', '.join(map(repr, alike))} would leave files of one name; expected names that differ in "
            "letters or digits."
        )
    estimators = {name: load_estimator(weights) for name, weights in models.items()}
    test = held_out_poses(data, subjects, every=every)
    for estimator in estimators.values():
        seen = test.in_order_of(estimator.joints, estimator.keypoints)
        check_suits(estimator, Context(torch.from_numpy(seen.keypoints), torch.from_numpy(seen.observed)))
    try:
        folder.mkdir(exist_ok=True)
    except OSError as problem:
        raise PoseFileError(f"{folder}: can't be made ({problem.strerror}).") from problem
    rows: list[Judged] = []
    for name, estimator in estimators.items():
        with counted(name, seeds * len(test)) as progress:
            rows.append(judge(name, estimator, test, n=n, seeds=range(seeds), progress=progress))
    table = markdown(rows)
    _write(folder / "table.md", table + "\n")
    about = {
        "poses": len(test),
        "subjects": subjects,
        "hypotheses": n,
        "seeds": seeds,
        "hidden_share": float((~test.observed).mean()),
        "rows": {row.name: {**row.values, "seconds": round(row.seconds, 1)} for row in rows},
    }
    _write(folder / "benchmark.json", json.dumps(about, indent=1) + "\n")
    reports = {row.name: row.report for row in rows if row.report is not None}
    if reports:
        save(pictures.reliability_grid(reports), folder / "reliability.png")
    for name, report in reports.items():
        report.save(folder / f"{_stem(name)}.npz")
    for name, estimator in estimators.items():
        if isinstance(estimator, CGNF):
            _draw(estimator, test, folder, _stem(name))
    return table


def seen_in_training(weights: str, subjects: list[str]) -> list[str]:
    """Name the subjects that weights were not held out from, by their own notes.

    Parameters
    ----------
    weights : str
        Named weights or a file.
    subjects : list of str
        Test subjects.

    Returns
    -------
    list of str
        Those that were not among the test subjects of the training; none where the notes don't say.
    """
    data = notes_of(weights).get("config", {}).get("data", {})
    return [subject for subject in subjects if "test_subjects" in data and subject not in data["test_subjects"]]


def _stem(name: str) -> str:
    return "-".join("".join(letter if letter.isalnum() else " " for letter in name.lower()).split())


def _draw(estimator: CGNF, test: LiftingSet, folder: Path, stem: str) -> None:
    """Draw hypotheses of evenly spread images, and poses of the prior: none chosen by hand."""
    rows = np.linspace(0, len(test) - 1, _SHOWN + 2)[1:-1].astype(int)
    some = test.take(rows).in_order_of(estimator.joints, estimator.keypoints)
    drawn = np.pad(hypotheses_of(estimator, some, 50), ((0, 0), (0, 0), (1, 0), (0, 0)))
    truth = np.pad(some.poses, ((0, 0), (1, 0), (0, 0)))
    columns = [
        (f"{frame}\n{int((~seen).sum())} of 16 hidden", drawn[:, index], truth[index])
        for index, (frame, seen) in enumerate(zip(some.frame_id, some.observed, strict=True))
    ]
    joints = (some.root, *some.joints)
    save(pictures.hypotheses(columns, joints, cloud="RWrist"), folder / f"{stem}-hypotheses.png")
    with torch.inference_mode():
        prior = estimator.prior().sample(10, generator=seeded("cpu", 0))[:, 0].numpy()
    save(pictures.prior(np.pad(prior, ((0, 0), (1, 0), (0, 0))), joints), folder / f"{stem}-prior.png")


def _write(path: Path, text: str) -> None:
    write_file(path, lambda file: file.write(text.encode()))
