"""Speed of the models: medians of log_prob, samples and a training step, and of the plain formulas in the same run.

    python tests/benchmarks/models_speed.py [--sizes small large xlarge] [--device cpu] [--threads 1] [--compile]

The plain formulation computes the messages of the context anew for every sample and walks the bones one relation at a
time. A training step has 200 graphs and their 200 priors. "Alone" are the second layers' matrix products in the same
run: the floor of any arrangement. With --compile, what torch.compile makes of log_prob, samples and the step runs in
the same run too. With --published FOLDER, a checkout of github.com/sinzlab/propose (it needs torch_geometric,
torch_sparse, nflows and wandb), its model runs in the same run.

With --device cuda this one command measures all that docs/models.md says about a GPU: the tables, whether a seed gives
the hypotheses of a CPU, the memory of many hypotheses, and an epoch of the published size (390,000 poses, five graphs
and a prior each), extrapolated from steps that are plain, compiled and recorded.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch

sys.path.insert(0, str(Path(__file__).parents[2]))

from posecal_models.checkpoint import load_estimator
from posecal_models.contract import Context
from posecal_models.cuda_graph import RecordedStep
from posecal_models.estimators.cgnf.flow import SIZES
from posecal_models.estimators.cgnf.graph import human36m_graph
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.objectives import FlowLikelihood
from tests.models import plain_cgnf

GRAPHS, SAMPLES = 200, 200
VARIANTS = {"paper": (True, "exp"), "released": (False, "sigmoid")}


def medians(*calls: Callable[[], object] | None, device: str, most_seconds: float = 60.0) -> list[float | None]:
    """Median of at least three calls each, in ms, after one to warm up; in turns: a slow minute is shared.

    Of one thread the time of the processor counts, so that other processes count for less.
    """
    clock = time.process_time if device == "cpu" and torch.get_num_threads() == 1 else time.perf_counter

    def timed(call: Callable[[], object]) -> float:
        start = clock()
        call()
        if device.startswith("cuda"):
            torch.cuda.synchronize()
        return clock() - start

    there = [call for call in calls if call is not None]
    first = sum(timed(call) for call in there)
    repeats = int(min(20, max(3, most_seconds / max(first, 1e-4))))
    rounds = [[timed(call) for call in there] for _ in range(repeats)]
    found = iter(1000 * statistics.median(times) for times in zip(*rounds, strict=True))
    return [None if call is None else next(found) for call in calls]


def row(name: str, ours: float | None, alone: float | None, *others: float | None) -> None:
    """One line of the table: ours, the products alone, and what ours is compared with."""
    compared = (f"{other:12,.1f} {other / ours:7.1f} x" if ours and other else f"{'':22}" for other in others)
    print(
        f"{name:48} {ours:9,.1f} {'' if alone is None else f'{alone:,.1f}':>9} {''.join(compared)}".rstrip(), flush=True
    )


class Published:
    """The published small model, random weights, on the graphs that ours are given."""

    def __init__(self, folder: str) -> None:
        sys.path.insert(0, folder)
        from propose.models.flows import CondGraphFlow
        from propose.models.nn.embedding import SageEmbedding
        from torch_geometric.data import HeteroData

        self._data = HeteroData
        sizes = {"features": 3, "num_layers": 10, "context_features": 10, "hidden_features": 100}
        self.flow = CondGraphFlow(**sizes, embedding_net=SageEmbedding(2, 128, 10), use_attention=False)
        self.optimizer = torch.optim.Adam(self.flow.parameters(), 1e-4)
        graph = human36m_graph()
        self._bones, self._near = torch.tensor(graph.bones).T, torch.tensor(graph.next_to_root)

    def graphs(self, poses: torch.Tensor, keypoints: torch.Tensor, observed: torch.Tensor) -> Any:
        """Poses (G, 16, 3) as one graph; the first of them have keypoints (P, 16, 2), of which some are observed."""
        data, count = self._data(), len(poses)
        first = 16 * torch.arange(count)
        data["x"].x, data["x"].batch = poses.reshape(-1, 3).clone(), torch.arange(count).repeat_interleave(16)
        data["c"].x, data["r"].x = keypoints.reshape(-1, 2).clone(), torch.zeros(count, 3)
        bones = (self._bones[:, None] + first[:, None]).flatten(1)
        seen = observed.flatten().nonzero().squeeze(1)
        root = torch.stack([torch.arange(count).repeat_interleave(3), (self._near + first[:, None]).flatten()])
        edges = {("x", "->", "x"): bones, ("x", "<-", "x"): bones, ("c", "->", "x"): seen.repeat(2, 1)}
        for relation, index in {**edges, ("r", "->", "x"): root, ("r", "<-", "x"): root}.items():
            data[relation].edge_index = index
        return data

    def log_prob(self, *inputs: torch.Tensor) -> object:
        """Log densities of poses."""
        return self.flow(self.graphs(*inputs))

    def sample(self, *inputs: torch.Tensor) -> object:
        """200 samples of each pose."""
        return self.flow.sample(SAMPLES, self.graphs(*inputs))

    def step(self, poses: torch.Tensor, keypoints: torch.Tensor, observed: torch.Tensor) -> None:
        """One training step: every graph and its prior."""
        self.optimizer.zero_grad()
        nats = -self.flow(self.graphs(torch.cat([poses, poses]), keypoints, observed))
        (0.5 * nats[nats.numel() // 2 :].mean() + 0.5 * nats[: nats.numel() // 2].mean()).backward()
        torch.nn.utils.clip_grad_norm_(self.flow.parameters(), 1.0)
        self.optimizer.step()


def bare_products(model: CGNF, graphs: int, device: str) -> Callable[[], object]:
    """The matrix products of the second layers alone, for so many graphs: what no arrangement can do without."""
    second = [block.fold(model.flow.aggregation).second.detach() for block in model.flow.couplings]
    at_once, nodes = 48, len(model.joints)
    senders = torch.randn(nodes * at_once, len(second[0]), device=device)
    messages = torch.empty(len(senders), second[0].shape[1], device=device)

    def multiply() -> None:
        for start in range(0, graphs, at_once):
            rows = nodes * min(at_once, graphs - start)
            for weights in second:
                torch.mm(senders[:rows], weights, out=messages[:rows])

    return multiply


def measure(
    size: str, variant: str, device: str, *, plain: bool, compile_too: bool, published: Published | None
) -> None:
    """Print the lines of one size and variant."""
    backward_weights, scale = VARIANTS[variant]
    torch.manual_seed(0)
    model = CGNF(SIZES[size], backward_weights=backward_weights, scale=scale).to(device)
    for block in model.flow.couplings:
        block.second.pool.weight.data.uniform_(-0.01, 0.01)
    weights, parents = dict(model.flow.named_parameters()), model.graph.parents
    root = torch.zeros(1, 3, device=device)
    for poses in (1, 32):
        keypoints = torch.randn(poses, 16, 2, device=device)
        observed = torch.rand(poses, 16, device=device) < 0.88
        truth = torch.randn(poses, 16, 3, device=device)
        latents = torch.randn(poses, SAMPLES, 16, 3, device=device)
        every = latents.flatten(0, 1), keypoints.repeat_interleave(SAMPLES, 0), observed.repeat_interleave(SAMPLES, 0)

        def log_prob(k=keypoints, o=observed, x=truth) -> object:
            return model.flow.condition(model.flow.embed(k, o)).log_prob_per_node(x[:, None])

        def sample(k=keypoints, o=observed, z=latents) -> object:
            return model.flow.condition(model.flow.embed(k, o)).inverse(z)

        def plain_log_prob(k=keypoints, o=observed, x=truth) -> object:
            return plain_cgnf.log_prob(weights, x, k, o, root, parents, scale=scale)

        def plain_sample(all_of_them=every) -> object:
            return plain_cgnf.inverse(weights, *all_of_them, root, parents, scale=scale)

        def published_log_prob(k=keypoints, o=observed, x=truth) -> object:
            return published.log_prob(x, k, o)

        def published_sample(k=keypoints, o=observed, x=truth) -> object:
            return published.sample(x, k, o)

        with torch.inference_mode():
            bare = bare_products(model, SAMPLES * poses, device)
            description = f"{poses} pose{'s' * (poses > 1)}, {size}, {variant}"
            others = plain_log_prob if plain else None, published_log_prob if published else None
            calls = log_prob, None, *others, torch.compile(log_prob) if compile_too else None
            row(f"log_prob of {description}", *medians(*calls, device=device))
            others = plain_sample if plain else None, published_sample if published else None
            calls = sample, bare, *others, torch.compile(sample) if compile_too else None
            row(f"{SAMPLES} samples of {description}", *medians(*calls, device=device))
    options = {"plain": plain, "compile_too": compile_too, "published": published}
    measure_step(model, scale, f"{size}, {variant}", device, **options)


def measure_step(
    model: CGNF,
    scale: str,
    which: str,
    device: str,
    *,
    plain: bool,
    compile_too: bool,
    published: Published | None,
) -> None:
    """Print the lines of a training step."""
    weights, parents = dict(model.flow.named_parameters()), model.graph.parents
    root = torch.zeros(1, 3, device=device)
    keypoints = torch.randn(GRAPHS, 16, 2, device=device)
    share = torch.tensor([1.0, 0.2, 0.4, 0.6, 0.8], device=device).repeat(GRAPHS // 5)
    observed = torch.rand(GRAPHS, 16, device=device) < 0.88 * share[:, None]
    truth = torch.randn(GRAPHS // 5, 16, 3, device=device).repeat_interleave(5, 0)
    optimizer = torch.optim.Adam(model.parameters(), 1e-4, fused=True)
    objective = FlowLikelihood(model)
    compiled = torch.compile(objective) if compile_too else objective
    context = Context(keypoints, observed)

    def step(graphs_per_pose: int, losses: Callable[..., Any] = objective) -> None:
        optimizer.zero_grad()
        losses(context, truth, graphs_per_pose=graphs_per_pose)["loss"].backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()

    def plain_step() -> None:
        optimizer.zero_grad()
        posterior = plain_cgnf.log_prob(weights, truth, keypoints, observed, root, parents, scale=scale)
        prior = plain_cgnf.log_prob(weights, truth, keypoints, torch.zeros_like(observed), root, parents, scale=scale)
        (-0.5 * (posterior + prior).mean()).backward()
        torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
        optimizer.step()

    def published_step() -> None:
        published.step(truth, keypoints, observed)

    bare = bare_products(model, 3 * (GRAPHS + GRAPHS // 5), device)  # once forwards and twice backwards
    slow = plain_step if plain else None, published_step if published else None
    slow = *slow, (lambda: step(5, compiled)) if compile_too else None
    ours, shared, alone, *others = medians(lambda: step(1), lambda: step(5), bare, *slow, device=device)
    row(f"training step, {which}", ours, None, *others)
    row(f"  priors of 40 poses shared, {which}", shared, alone, *others)


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sizes", nargs="+", default=["small", "large", "xlarge"], choices=[*SIZES])
    parser.add_argument("--variants", nargs="+", default=["paper", "released"], choices=[*VARIANTS])
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--no-plain", action="store_true", help="leave the plain formulation out")
    parser.add_argument("--compile", action="store_true", help="measure torch.compile too")
    parser.add_argument("--published", metavar="FOLDER", help="a checkout of the published code, for the small model")
    asked = parser.parse_args()
    torch.set_num_threads(asked.threads)
    name = torch.cuda.get_device_name() if asked.device.startswith("cuda") else f"CPU, {asked.threads} thread(s)"
    print(f"PyTorch {torch.__version__}, {name}, single precision; medians in ms")
    compared = "".join(f"{head:>12} {'ratio':>9}" for head in ("plain", "published", "compiled"))
    print(f"{'':48} {'ours':>9} {'alone':>9} {compared}")
    published = Published(asked.published) if asked.published else None
    for size in asked.sizes:
        for variant in asked.variants:
            other = published if size == "small" else None
            options = {"plain": not asked.no_plain, "compile_too": asked.compile, "published": other}
            measure(size, variant, asked.device, **options)
    if asked.device.startswith("cuda"):
        compare_with_cpu(asked.device)
        measure_epoch(asked.device)


def compare_with_cpu(device: str) -> None:
    """Print how far hypotheses of one seed on a GPU are from those on the CPU, and the memory of many."""
    estimator = load_estimator("cgnf-small")
    generator = torch.Generator().manual_seed(0)
    context = Context(80 * torch.randn(64, 16, 2, generator=generator), torch.rand(64, 16, generator=generator) < 0.7)
    with torch.inference_mode():
        on_cpu = estimator(context).sample(200, generator=torch.Generator().manual_seed(1))
        estimator, context = estimator.to(device), context.to(device)
        on_gpu = estimator(context).sample(200, generator=torch.Generator().manual_seed(1))
        print(f"seed 1, CPU and GPU: largest difference {float((on_cpu - on_gpu.cpu()).abs().max()):.2g} mm")
        torch.cuda.reset_peak_memory_stats()
        estimator(context).sample(10_000)
    print(f"10,000 hypotheses of 64 poses: {torch.cuda.max_memory_allocated() / 1e9:.1f} GB")


def measure_epoch(device: str, *, steps: int = 50) -> None:
    """Extrapolate a published epoch on a GPU: 390,000 poses, five graphs and a prior each."""
    for poses in (40, 400, 4000):
        truth = torch.randn(poses, 16, 3, device=device).repeat_interleave(5, 0)
        keypoints = torch.randn(5 * poses, 16, 2, device=device)
        observed = torch.rand(5 * poses, 16, device=device) < 0.5
        for name in ("plain", "compiled", "recorded"):
            model = CGNF(SIZES["small"]).to(device)
            objective = FlowLikelihood(model)
            losses = torch.compile(objective) if name == "compiled" else objective
            rate = torch.tensor(1e-4, device=device)
            optimizer = torch.optim.Adam(model.parameters(), rate, fused=True, capturable=True)

            def update(keypoints, observed, truth, losses=losses, optimizer=optimizer, model=model) -> torch.Tensor:
                optimizer.zero_grad()
                loss = losses(Context(keypoints, observed), truth, graphs_per_pose=5)["loss"]
                loss.backward()
                torch.nn.utils.clip_grad_norm_(model.parameters(), 1.0)
                optimizer.step()
                return loss.detach()

            call = RecordedStep(update, torch.device(device)) if name == "recorded" else update
            for count in (5, steps):
                torch.cuda.synchronize()
                start = time.perf_counter()
                for _ in range(count):
                    call(keypoints, observed, truth)
                torch.cuda.synchronize()
            seconds = (time.perf_counter() - start) / steps
            print(
                f"small, {poses:,} poses a step, {name}: {1000 * seconds:.2f} ms, "
                f"a published epoch {seconds * 390_000 / poses:.1f} s"
            )


if __name__ == "__main__":
    main()
