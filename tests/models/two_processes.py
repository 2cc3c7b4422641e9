"""Run by ``torchrun`` in a test: one step of a training, its gradients kept."""

from __future__ import annotations

import sys
from pathlib import Path

import torch

from posecal_models.checkpoint import save_estimator
from posecal_models.config import Config
from posecal_models.distributed import crew_of_torchrun
from posecal_models.preparation import prepare
from posecal_models.simple_baseline import SimpleBaseline


def main() -> None:
    kind, motion, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
    table = {"model": {"size": "tiny"}, "data": {"views": 1}, "train": {"batch": 7, "clip": 1e9, "graphs_per_pose": 2}}
    with crew_of_torchrun(torch.device("cpu")) as crew:
        if kind == "gaussian":
            mean = folder / f"mean_{crew.size}_{crew.rank}.safetensors"
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(0)
                save_estimator(mean, SimpleBaseline(width=8))
            table["model"] = {"kind": "gaussian-noise", "mean": str(mean)}
        run = prepare(Config.of_table(table), motion, folder / f"run_{crew.size}_{crew.rank}", crew=crew)
        run.optimizer.step = lambda: None
        run._one_step()
        if crew.leads:
            torch.save({n: p.grad for n, p in run.parameters.items()}, folder / f"gradients_{crew.size}.pt")


if __name__ == "__main__":
    main()
