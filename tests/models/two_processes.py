"""Script for ``torchrun`` in a test: the gradients of one step of every kind of training, and a complete training."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import torch

from posecal_models.checkpoint import save_estimator
from posecal_models.config import Config
from posecal_models.distributed import ProcessGroup, torchrun_group
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.preparation import prepare

BASELINE = {"kind": "simple-baseline", "width": 8, "residuals": 1}
# Dropout, batch norm on CPUs and the noise of min-mpjpe are those of each process, so these differ from a single one.
KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "cgnf": ({"size": "tiny"}, {}),
    "cgnf with L_sample": ({"size": "tiny"}, {"sample_weight": 0.1}),
    "gaussian, likelihood": ({"kind": "gaussian-noise"}, {}),
}
DATA = {"views": 1, "every": 2, "validation_subjects": ["S4"]}


def one_step(kind: str, motion: str, folder: Path, processes: ProcessGroup) -> dict[str, torch.Tensor]:
    """Gradients and losses of the first step."""
    model, train = KINDS[kind]
    if model.get("kind") == "gaussian-noise":
        model = {**model, "mean": str(folder / "mean.safetensors")}
    table = {"model": model, "data": DATA, "train": {"batch": 8, "clip": 1e9, "graphs_per_pose": 2, **train}}
    run = prepare(Config.from_table(table), motion, folder / f"{kind}, {processes.size}", processes=processes)
    run.optimizer.step = lambda: None
    run.one_step()
    gradients = {name: p.grad for name, p in run.parameters.items() if p.grad is not None}
    return {**gradients, "loss": torch.tensor(run.step_losses)}


def to_the_end(motion: str, folder: Path, processes: ProcessGroup) -> dict[str, torch.Tensor]:
    """Weights and progress of a training whose learning rate falls on plateaus."""
    train = {"batch": 8, "objective": "squared-error", "patience": 0, "steps_per_epoch": 2, "epochs": 30}
    table = {"model": BASELINE, "data": DATA, "train": {**train, "learning_rate": 0.05}}
    run = prepare(Config.from_table(table), motion, folder / f"to the end, {processes.size}", processes=processes)
    rows = []
    run.run(on_step=lambda s: rows.append((s.step, s.learning_rate, s.losses["loss"], s.validation or 0.0)))
    return {**run.estimator.state_dict(), "progress": torch.tensor(rows, dtype=torch.float64)}


def save_mean(folder: Path) -> None:
    """Write the point estimator of the Gaussian noise models."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        save_estimator(folder / "mean.safetensors", SimpleBaseline(width=8))


def main() -> None:
    motion, folder = sys.argv[1], Path(sys.argv[2])
    with torchrun_group(torch.device("cpu")) as processes:
        results = {kind: one_step(kind, motion, folder, processes) for kind in KINDS}
        results["to the end"] = to_the_end(motion, folder, processes)
    torch.save(results, folder / f"of_{processes.rank}.pt")


if __name__ == "__main__":
    main()
