"""Flows with random weights, and inputs for them."""

from __future__ import annotations

import torch
from torch import Tensor

from posecal_models.contract import Context
from posecal_models.estimators.cgnf.flow import FlowSize, GraphFlow
from posecal_models.estimators.cgnf.graph import human36m_graph

SIZE = FlowSize(blocks=4, hidden=6, context=3, embedding=5)
POSES, SAMPLES, NODES = 7, 5, 16


def random_flow(*, seed: int = 0, spread: float | None = None, **options) -> GraphFlow:
    """A flow with weights of size ``spread``, in double precision; an exponential scale takes smaller ones."""
    if spread is None:
        spread = 0.3 if options.get("scale") == "sigmoid" else 0.12
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        flow = GraphFlow(human36m_graph(), SIZE, **options).double()
        for parameter in flow.parameters():
            parameter.data = torch.randn_like(parameter) * spread
    return flow


def inputs(seed: int = 1) -> tuple[Tensor, Tensor, Tensor]:
    """Keypoints, observed and poses with samples."""
    generator = torch.Generator().manual_seed(seed)
    keypoints = torch.randn(POSES, NODES, 2, generator=generator, dtype=torch.float64)
    observed = torch.rand(POSES, NODES, generator=generator) < 0.6
    poses = torch.randn(POSES, SAMPLES, NODES, 3, generator=generator, dtype=torch.float64)
    return keypoints, observed, poses


def repeat_per_sample(keypoints: Tensor, observed: Tensor) -> tuple[Tensor, Tensor]:
    """Keypoints and observed once for every sample, the inputs of the naive twin."""
    return keypoints.repeat_interleave(SAMPLES, 0), observed.repeat_interleave(SAMPLES, 0)


def with_hip_keypoint(keypoints: Tensor, observed: Tensor) -> Context:
    """A context of keypoints given relative to the hip, whose own keypoint is at (500, -300) pixels."""
    hip = torch.tensor([[[500.0, -300.0]]], dtype=keypoints.dtype).expand(len(keypoints), 1, 2)
    hip_observed = torch.ones_like(observed[:, :1])
    return Context(torch.cat([hip, keypoints + hip], dim=1), torch.cat([hip_observed, observed], dim=1))
