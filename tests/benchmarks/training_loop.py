"""Time that posecal takes in a training loop, beside a training step and beside the drawing of the hypotheses.

    python -m tests.benchmarks.training_loop --device cuda

Batches of 64 poses of 16 joints with 200 hypotheses each, single precision; the small cGNF, whose steps are the
shortest of all its sizes. Times on a CPU are of the processor.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import torch

import posecal
from posecal.torch import PoseMetric
from posecal_models.contract import Context
from posecal_models.estimators.cgnf.flow import SIZES
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.objectives import FlowLikelihood
from tests.benchmarks.speed import seconds

POSES, N, K = 64, 200, 16
METRICS = {"the default metrics": "default", "min_mpjpe and ece": ["min_mpjpe", "ece"]}


def update(metrics: str | list[str], hypotheses: torch.Tensor, truth: torch.Tensor) -> Callable[[], None]:
    """Give the addition of a batch to a metric that goes on."""
    metric = PoseMetric(posecal.Evaluation(unit="mm", axes="MNKD", metrics=metrics, threads=1))
    return lambda: metric.update(hypotheses, truth, sequence="walk")


def finished(call: Callable[[], object]) -> Callable[[], None]:
    """Give a call that waits until the GPU has done what it asks for."""

    def run() -> None:
        call()
        torch.cuda.synchronize()

    return run


def main() -> None:
    """Print medians in ms, and how many training steps each is."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu")
    device = parser.parse_args().device
    torch.set_num_threads(1)
    torch.manual_seed(0)
    model = CGNF(SIZES["small"]).to(device)
    optimizer, objective = torch.optim.Adam(model.parameters(), 1e-4), FlowLikelihood(model)
    keypoints = torch.randn(POSES, K, 2, device=device)
    observed = torch.rand(POSES, K, device=device) < 0.88
    truth = 300 * torch.randn(POSES, K, 3, device=device)
    hypotheses = truth[:, None] + 50 * torch.randn(POSES, N, K, 3, device=device)

    def step() -> None:
        optimizer.zero_grad(set_to_none=False)
        objective(Context(keypoints, observed), truth / 300)["loss"].backward()
        optimizer.step()

    def sample() -> None:
        with torch.inference_mode():
            model.flow.condition(model.flow.embed(keypoints, observed)).inverse(torch.randn_like(hypotheses))

    calls = {
        f"a training step of {POSES} poses": step,
        f"{N} hypotheses of {POSES} poses are drawn": sample,
        "they are copied to the host": lambda: hypotheses.cpu().clone(),
        **{f"they are added: {name}": update(chosen, hypotheses, truth) for name, chosen in METRICS.items()},
    }
    is_gpu = device.startswith("cuda")
    name = torch.cuda.get_device_name() if is_gpu else "CPU"
    print(f"PyTorch {torch.__version__}, {name}, 1 thread of the host; medians, and in training steps")
    base = 0.0
    for what, call in calls.items():
        run = finished(call) if is_gpu else call
        run()
        took = seconds(run, 3 if call is sample else 9, threads=2 if is_gpu else 1)  # of more than one: by the clock
        base = base or took
        print(f"{what:44} {took * 1e3:9.1f} ms {took / base:7.3f}", flush=True)


if __name__ == "__main__":
    main()
