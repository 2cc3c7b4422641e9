"""Evaluation in two processes of torch.distributed: what docs/training-loop.md shows, run by its test."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import torch
import torch.distributed as dist
from torch.utils.data import DataLoader, Dataset
from torch.utils.data.distributed import DistributedSampler

import posecal
from posecal.torch import PoseMetric

M, N, K = 61, 8, 4


class Frames(Dataset[dict[str, object]]):
    """Random poses in clips of ten frames."""

    def __init__(self) -> None:
        random = torch.Generator().manual_seed(0)
        self.poses = 300 * torch.randn(M, K, 3, generator=random)
        self.hypotheses = self.poses[:, None] + 50 * torch.randn(M, N, K, 3, generator=random)

    def __len__(self) -> int:
        return M

    def __getitem__(self, i: int) -> dict[str, object]:
        return {"image": self.hypotheses[i], "pose": self.poses[i], "clip": f"clip {i // 10}", "id": i}


def model(images: torch.Tensor) -> torch.Tensor:
    """Give the hypotheses, which the images of this test are."""
    return images


def run(rank: int, processes: int, folder: Path) -> None:
    """Evaluate the share of one process; the first writes the numbers of all."""
    store = dist.FileStore(str(folder / "store"), processes)
    dist.init_process_group("gloo", store=store, rank=rank, world_size=processes)
    frames = Frames()
    # docs: begin
    loader = DataLoader(frames, batch_size=8, sampler=DistributedSampler(frames, shuffle=False))
    evaluation = posecal.Evaluation(unit="mm", axes="MNKD")
    for batch in loader:
        hypotheses = model(batch["image"])
        evaluation.update(hypotheses, batch["pose"], sequence=batch["clip"], frame_id=batch["id"])

    gathered = [None] * dist.get_world_size()
    dist.all_gather_object(gathered, evaluation)
    total, *others = gathered
    for other in others:
        total.merge(other)
    report = total.compute()
    print(*report.remarks, sep="\n")
    # docs: end
    if rank == 0:
        numbers = {"poses": int(report.totals.poses.sum()), "remarks": report.remarks, **report.scalars()}
        (folder / "numbers.json").write_text(json.dumps(numbers))
    metric = PoseMetric(posecal.Evaluation(unit="mm", axes="MNKD"))
    for batch in loader:
        metric.update(model(batch["image"]), batch["pose"], sequence=batch["clip"], frame_id=batch["id"])
    numbers = {name: value.item() for name, value in metric.compute().items()}
    numbers["own poses"] = int(metric.evaluation.compute().totals.poses.sum())
    (folder / f"metric of {rank}.json").write_text(json.dumps(numbers))
    dist.destroy_process_group()


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    run(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
