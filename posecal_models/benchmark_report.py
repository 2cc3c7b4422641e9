"""Output files of the benchmark: table, numbers as JSON, a saved result of each model, and figures, in one folder.

The saved results are input of ``posecal compare`` and ``posecal report``.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from posecal.data.write import write_file, written_together
from posecal.errors import PoseDataError, PoseFileError
from posecal.plot import save
from posecal_models import figures
from posecal_models.benchmark import BenchmarkRow, draw_hypotheses, evaluate_estimator, held_out_poses, markdown
from posecal_models.checkpoint import load_estimator, notes_of
from posecal_models.contract import Context
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.training_set import seeded_generator
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.progress import progress_bar
from posecal_models.sample import check_input

__all__ = ["leaked_subjects", "run_benchmark"]

_EXAMPLES = 7


def run_benchmark(
    data: Path,
    models: dict[str, str],
    subjects: list[str],
    folder: Path,
    *,
    n: int = 200,
    every: int = 16,
    seeds: int = 3,
    device: torch.device | str = "cpu",
) -> str:
    """Evaluate estimators and write all results into a folder.

    Parameters
    ----------
    data : Path
        Motion capture.
    models : dict of str to str
        Weights by the names of the rows.
    subjects : list of str
        Test subjects.
    folder : Path
        Output folder; created if its parent exists.
    n, every, seeds : int
        Hypotheses, frame step and number of sampling seeds.
    device : torch.device or str
        Device of the estimators.

    Returns
    -------
    str
        The table in Markdown.

    Raises
    ------
    PoseFileError, PoseDataError
        Where a file can't be read or written, models and images don't fit, or two models would share a file name.
    """
    stems = [_stem(name) for name in models]
    if ambiguous := [name for name in models if not _stem(name) or stems.count(_stem(name)) > 1]:
        raise PoseDataError(
            f"models: {', '.join(map(repr, ambiguous))} give files of the same name; expected names that differ in "
            "letters or digits."
        )
    estimators = {name: load_estimator(weights, device=device) for name, weights in models.items()}
    test = held_out_poses(data, subjects, every=every)
    for estimator in estimators.values():
        ordered = test.in_order_of(estimator.joints, estimator.keypoints)
        context = Context(torch.from_numpy(ordered.keypoints), torch.from_numpy(ordered.observed))
        check_input(estimator, context.to(device))
    try:
        folder.mkdir(exist_ok=True)
    except OSError as problem:
        raise PoseFileError(f"{folder}: can't be made ({problem.strerror}).") from problem
    rows: list[BenchmarkRow] = []
    for name, estimator in estimators.items():
        with progress_bar(name, seeds * len(test)) as progress:
            rows.append(evaluate_estimator(name, estimator, test, n=n, seeds=range(seeds), progress=progress))
    table = markdown(rows)
    about = {
        "poses": len(test),
        "subjects": subjects,
        "hypotheses": n,
        "seeds": seeds,
        "hidden_share": float((~test.observed).mean()),
        "rows": {row.name: {**row.values, "seconds": round(row.seconds, 1)} for row in rows},
    }
    reports = {row.name: row.report for row in rows if row.report is not None}
    with written_together():
        _write(folder / "table.md", table + "\n")
        _write(folder / "benchmark.json", json.dumps(about, indent=1) + "\n")
        if reports:
            save(figures.reliability_grid(reports), folder / "reliability.png")
        if len(reports) > 1:
            save(figures.model_sizes({row.name: row.values for row in rows if row.report}), folder / "sizes.png")
        for name, report in reports.items():
            report.save(folder / f"{_stem(name)}.npz")
        for name, estimator in estimators.items():
            if isinstance(estimator, CGNF):
                _save_figures(estimator, test, folder, _stem(name))
    return table


def leaked_subjects(weights: str, subjects: list[str]) -> list[str]:
    """Name the test subjects that were in the training set, according to the notes of the weights.

    Parameters
    ----------
    weights : str
        Named weights or a file.
    subjects : list of str
        Test subjects.

    Returns
    -------
    list of str
        Those that were not among the test subjects of the training; empty where the notes hold no configuration.
    """
    data = notes_of(weights).get("config", {}).get("data", {})
    return [subject for subject in subjects if "test_subjects" in data and subject not in data["test_subjects"]]


def _stem(name: str) -> str:
    return "-".join("".join(letter if letter.isalnum() else " " for letter in name.lower()).split())


def _save_figures(estimator: CGNF, test: LiftingSet, folder: Path, stem: str) -> None:
    """Plot hypotheses of evenly spaced images, and poses of the prior: none selected by hand."""
    rows = np.linspace(0, len(test) - 1, _EXAMPLES + 2)[1:-1].astype(int)
    examples = test.take(rows).in_order_of(estimator.joints, estimator.keypoints)
    drawn = np.pad(draw_hypotheses(estimator, examples, 50), ((0, 0), (0, 0), (1, 0), (0, 0)))
    truth = np.pad(examples.poses, ((0, 0), (1, 0), (0, 0)))
    columns = [
        (f"{frame}\n{int((~observed).sum())} of 16 hidden", drawn[:, index], truth[index])
        for index, (frame, observed) in enumerate(zip(examples.frame_id, examples.observed, strict=True))
    ]
    joints = (examples.root, *examples.joints)
    save(figures.hypotheses(columns, joints, cloud="RWrist"), folder / f"{stem}-hypotheses.png")
    with torch.inference_mode():
        prior = estimator.prior().sample(10, generator=seeded_generator(0))[:, 0].cpu().numpy()
    save(figures.prior(np.pad(prior, ((0, 0), (1, 0), (0, 0))), joints), folder / f"{stem}-prior.png")


def _write(path: Path, text: str) -> None:
    write_file(path, lambda file: file.write(text.encode()))
