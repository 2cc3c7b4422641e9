"""What a GPU needs, watched without one: the operators of a training step, on tensors of the meta device.

Meta tensors have no values, so that whatever reads one, as a synchronisation does, raises an error.
"""

from __future__ import annotations

import contextlib
import itertools
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from posecal.errors import PoseDataError
from posecal_models.checkpoint import load_estimator, resolve_device
from posecal_models.config import Config
from posecal_models.contract import Context, standard_normal
from posecal_models.cuda_graph import RecordedStep
from posecal_models.data.detector import Detector
from posecal_models.data.masks import mask_keypoints
from posecal_models.estimators.registry import build_from_config
from posecal_models.estimators.simple_baseline import SimpleBaseline
from posecal_models.train import Training

BASELINE = {"model": {"kind": "simple-baseline", "width": 8}, "train": {"objective": "squared-error"}}
CASES: dict[str, dict[str, dict[str, Any]]] = {
    "cgnf, paper": {"model": {"size": "tiny"}},
    "cgnf, released": {"model": {"size": "tiny", "scale": "sigmoid", "backward_weights": False}},
    "cgnf, root": {"model": {"size": "tiny", "origin": "root", "units": "released"}},
    "cgnf, L_sample": {"model": {"size": "tiny"}, "train": {"sample_weight": 0.1, "sample_loss": "pairs"}},
    "simple-baseline": BASELINE,
    "gaussian, likelihood": {"model": {"kind": "gaussian-noise"}},
    "mixture-density": {
        "model": {"kind": "mixture-density", "width": 8, "variant": "released"},
        "train": {"objective": "published"},
    },
    "cvae, released": {
        "model": {"kind": "cvae", "width": 8, "variant": "released"},
        "train": {"objective": "published"},
    },
    "cvae, repaired": {"model": {"kind": "cvae", "width": 8}, "train": {"objective": "published"}},
    "inn, released": {
        "model": {"kind": "inn", "width": 8, "variant": "released"},
        "train": {"objective": "published", "hypotheses": 7, "clip_by": "value"},
    },
    "inn, repaired": {"model": {"kind": "inn", "width": 8}, "train": {"objective": "published", "hypotheses": 7}},
    "gaussian, min-mpjpe": {"model": {"kind": "gaussian-noise"}, "train": {"objective": "min-mpjpe"}},
    "amortised posterior": {"model": {"kind": "amortized-posterior", "width": 16}, "train": {"truth_noise": 5.0}},
}
GRAPHS = 10


class CaptureWatch(TorchDispatchMode):
    """Collects the operators that a recording of a CUDA stream refuses."""

    def __init__(self) -> None:
        super().__init__()
        self.seen = 0
        self.refused: list[str] = []

    def __torch_dispatch__(self, func, types, args=(), kwargs=None):
        kwargs = kwargs or {}
        tensors = [part for part in torch.utils._pytree.tree_leaves((args, kwargs)) if isinstance(part, torch.Tensor)]
        name = func.overloadpacket.__name__
        devices = {tensor.device.type for tensor in tensors if tensor.ndim or name in ("copy_", "_to_copy")}
        synchronises = name in ("_local_scalar_dense", "nonzero", "masked_select", "item", "_to_copy", "unique_dim")
        mask = name in ("index", "index_put", "index_put_") and any(t.dtype == torch.bool for t in tensors)
        if synchronises and not (name == "_to_copy" and "device" not in kwargs):
            self.refused.append(f"{name} synchronises")
        if mask:
            self.refused.append(f"{name} with a mask")
        if len(devices) > 1:
            self.refused.append(f"{name} between devices")
        if kwargs.get("generator") is not None:
            self.refused.append(f"{name} with a generator of its own")
        self.seen += 1
        return func(*args, **kwargs)


def training_of(table: dict[str, dict[str, Any]], device: str) -> tuple[Training, list[torch.Tensor]]:
    """A training on a device, and the inputs of a step."""
    config = Config.from_table(table)
    mean = SimpleBaseline(width=8) if config.model.kind == "gaussian-noise" else None
    estimator = build_from_config(config.model, mean=mean).to(device)

    class Data(SimpleNamespace):
        def __len__(self) -> int:
            return GRAPHS

    training = Training(estimator, config, Data(device=torch.device(device)), folder=Path())
    keypoints = torch.ones(GRAPHS, len(estimator.keypoints), 2, device=device)
    observed = torch.ones(keypoints.shape[:2], dtype=torch.bool, device=device)
    truth = torch.ones(GRAPHS, 16, 3, device=device)
    noise = training.objective.noise(truth, torch.Generator())
    return training, [keypoints, observed, keypoints[..., 0], truth, *([] if noise is None else [noise])]


@pytest.mark.parametrize("case", CASES)
def test_a_training_step_can_be_recorded(monkeypatch, case):
    # fused Adam has no meta tensors; it is watched on the CPU below
    idle = SimpleNamespace(zero_grad=lambda: None, step=lambda: None)
    monkeypatch.setattr(torch.optim, "AdamW", lambda *arguments, **options: idle)
    training, inputs = training_of(CASES[case], "meta")
    with CaptureWatch() as watch:
        losses = training.update(*inputs)
    assert losses.device.type == "meta"
    assert watch.seen > 20
    assert watch.refused == []


def test_the_optimizer_can_be_recorded():
    training, inputs = training_of(CASES["cgnf, paper"], "cpu")
    training.update(*inputs)
    with CaptureWatch() as watch:
        training._learning_rate.fill_(0.5)
        training.optimizer.step()
    assert watch.seen >= 2
    assert watch.refused == []
    assert training.optimizer.defaults["capturable"]


REFUSED = {
    "a synchronisation": lambda x: float(x.sum()),
    "a mask": lambda x: x[x > 0],
    "a number into one element": lambda x: x[0].copy_(torch.tensor(1.0)),
    "a generator": lambda x: torch.randn(3, generator=torch.Generator()),
    "a copy to the host": lambda x: x.cpu(),
}


@pytest.mark.parametrize("fault", REFUSED)
def test_the_watch_notices(fault):
    x = torch.ones(3, device="meta")
    with CaptureWatch() as watch, contextlib.suppress(RuntimeError, NotImplementedError):
        REFUSED[fault](x)
    assert watch.refused


def test_a_recorded_step_needs_cuda():
    with pytest.raises(PoseDataError, match=r"train\.cuda_graph: true with the device cpu; expected cuda"):
        RecordedStep(torch.neg, torch.device("cpu"))


@pytest.mark.parametrize("case", ["simple-baseline", "gaussian, min-mpjpe"])
def test_a_recorded_step_is_for_a_cgnf(case):
    table = {**CASES[case], "train": {**CASES[case].get("train", {}), "cuda_graph": True}}
    with pytest.raises(PoseDataError, match=r"train\.cuda_graph: true of a .*; expected a cgnf"):
        Config.from_table(table)


def test_random_numbers_are_drawn_on_the_cpu_and_moved():
    """The same draws on every device: nothing random is made on another device, everything arrives there."""

    class Draws(TorchDispatchMode):
        devices: set[str] = set()  # noqa: RUF012

        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            result = func(*args, **(kwargs or {}))
            if func.overloadpacket.__name__ in ("randn", "rand", "normal_", "uniform_", "randint", "randperm"):
                self.devices.add(result.device.type)
            return result

    with Draws() as draws:
        generator = torch.Generator()
        keypoints = torch.empty(4, 16, 2, device="meta")
        context = Detector().detect(keypoints, generator)
        masked = mask_keypoints(context.observed, torch.empty(4, device="meta"), generator)
        noise = standard_normal((2, 3), keypoints, generator)
        estimator = build_from_config(Config().model).to("meta")
        with torch.no_grad():
            drawn = estimator(Context(keypoints, masked)).sample(3, generator=generator)
        assert {t.device.type for t in (context.keypoints, masked, noise, drawn)} == {"meta"}
    assert draws.devices == {"cpu"}


def test_rows_on_a_gpu_are_bounded():
    """10,000 hypotheses of 64 poses: no activation has more than 2^17 rows of 48 messages of 100 features."""

    class Largest(TorchDispatchMode):
        numel = 0

        def __torch_dispatch__(self, func, types, args=(), kwargs=None):
            result = func(*args, **(kwargs or {}))
            for tensor in result if isinstance(result, (tuple, list)) else (result,):
                self.numel = max(self.numel, tensor.numel() if isinstance(tensor, torch.Tensor) else 0)
            return result

    with Largest() as largest, torch.no_grad():
        estimator = build_from_config(Config().model).to("meta")
        context = Context(torch.empty(64, 16, 2, device="meta"), torch.empty(64, 16, dtype=torch.bool, device="meta"))
        estimator(context).sample(10_000)
    assert largest.numel <= 2**17 * 48 * 100


def test_devices_that_torch_has_are_known(monkeypatch):
    assert resolve_device("cpu").type == "cpu"
    for kind, where in {"cuda": torch.cuda, "xpu": torch.xpu, "mps": torch.backends.mps}.items():
        monkeypatch.setattr(where, "is_available", lambda: False)
        with pytest.raises(
            PoseDataError, match=rf"device: {kind}, but PyTorch .* sees no such GPU; expected cpu or auto"
        ):
            resolve_device(kind)
        assert resolve_device("auto").type == "cpu"
        monkeypatch.setattr(where, "is_available", lambda: True)
        assert resolve_device(kind).type == resolve_device("auto").type == kind
        monkeypatch.setattr(where, "is_available", lambda: False)
    for wrong in ("meta", "no such"):
        with pytest.raises(PoseDataError, match=r"expected cpu, cuda, xpu, mps or auto"):
            resolve_device(wrong)


def test_the_seed_of_a_sample_is_that_of_a_cpu_generator():
    estimator = load_estimator("cgnf-small")
    context = Context(torch.zeros(2, 16, 2), torch.zeros(2, 16, dtype=torch.bool))
    with torch.inference_mode():
        drawn, again = (estimator(context).sample(3, generator=torch.Generator().manual_seed(1)) for _ in range(2))
        latents = torch.randn((2, 3, 16, 3), generator=torch.Generator().manual_seed(1))
        flow = estimator.flow.condition(estimator.embed(context))
        expected = estimator.standardizer.millimetres(flow.inverse(latents)).transpose(0, 1)
    assert torch.equal(drawn, again)
    torch.testing.assert_close(drawn, expected)


def test_losses_of_a_gpu_are_read_every_fifty_steps(monkeypatch, motion_file, tmp_path):
    """The counting, on a CPU that pretends to be none: a step that is not read gives no loss yet."""
    from posecal_models.preparation import prepare

    run = prepare(Config.from_table({**BASELINE, "data": {"views": 1}}), motion_file, tmp_path / "run")
    device = SimpleNamespace(type="pretended")
    update, read = run._update, []
    monkeypatch.setattr(type(run.data), "device", property(lambda _: device))
    monkeypatch.setattr(run, "_rows", lambda step: torch.arange(8))
    run._update = lambda *inputs: update(*inputs)
    for _ in itertools.repeat(None, 51):
        run.one_step()
        read.append(len(run.step_losses))
    assert read == [*[0] * 49, 50, 50]
    run.read_losses()
    assert len(run.step_losses) == 51


def test_a_gpu_that_is_not_there_is_refused():
    if torch.cuda.is_available():
        pytest.skip("there is one")
    with pytest.raises(PoseDataError, match=r"device: cuda, but PyTorch .* sees no such GPU"):
        resolve_device("cuda")
    assert resolve_device("auto").type == "cpu"


@pytest.mark.parametrize("name", ["gpu", "meta", "cuda:x"])
def test_an_unknown_device_is_refused(name):
    with pytest.raises(PoseDataError, match="expected cpu, cuda, xpu, mps or auto"):
        resolve_device(name)
