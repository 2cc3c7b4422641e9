"""Weights files: round trips, and errors for invalid or damaged ones."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import (
    _digest,
    convert_format_1,
    load_estimator,
    notes_of,
    save_estimator,
    write_tensors,
)
from posecal_models.contract import Context
from posecal_models.estimators.cgnf.flow import SIZES, FlowSize
from posecal_models.estimators.cgnf.graph import PoseGraph
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.cvae import CVAE
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.inn import INN
from posecal_models.estimators.mixture_density import MixtureDensityNetwork
from posecal_models.estimators.registry import build, describe
from posecal_models.estimators.simple_baseline import SimpleBaseline

ROOT = Path(__file__).parents[2]


def estimators():
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        chain = PoseGraph(("a", "b"), (-1, 0), root="r")
        baseline = SimpleBaseline(("a", "b"), ("b", "a"), width=8, residuals=1, origin="none")
        models = [
            CGNF(FlowSize(3, 5, 4, 6), chain, backward_weights=False, scale="sigmoid", origin="none"),
            CGNF(SIZES["tiny"]),
            baseline,
            GaussianNoise(SimpleBaseline(width=8), spread="coordinate"),
            MixtureDensityNetwork(("a", "b"), ("b", "a"), components=2, width=8, residuals=1, variant="released"),
            CVAE(width=8, residuals=1),
            INN(width=8),
        ]
    for estimator in models:
        for buffer in estimator.buffers():
            if buffer.ndim == 0 and buffer.is_floating_point():
                buffer.fill_(7.5)
    return models


@pytest.mark.parametrize("index", range(7))
def test_an_estimator_comes_back_from_its_file(tmp_path, index):
    estimator = estimators()[index].eval()
    save_estimator(tmp_path / "w.safetensors", estimator, notes={"poses": 12})
    back = load_estimator(tmp_path / "w.safetensors")
    assert describe(back) == describe(estimator)
    for name, tensor in estimator.state_dict().items():
        assert torch.equal(back.state_dict()[name], tensor), name
    assert notes_of(tmp_path / "w.safetensors") == {"poses": 12}
    count = len(estimator.keypoints)
    context = Context(torch.randn(3, count, 2), torch.ones(3, count, dtype=torch.bool))
    generator = torch.Generator()
    one, two = (e(context).sample(4, generator=generator.manual_seed(1)) for e in (estimator, back))
    assert torch.equal(one, two)


def test_weights_of_another_size_are_refused(tmp_path):
    small, large = estimators()[1], CGNF(FlowSize(6, 25, 8, 32))
    about = {"estimator": describe(large)}
    write_tensors(tmp_path / "w.safetensors", small.state_dict(), about)
    with pytest.raises(PoseDataError, match=r"weights don't fit the estimator: \d+ tensors of another size"):
        load_estimator(tmp_path / "w.safetensors")


def test_weights_that_lack_a_tensor_are_refused(tmp_path):
    tensors = estimators()[1].state_dict()
    tensors.pop("flow.embedding.adjacency")
    write_tensors(tmp_path / "w.safetensors", tensors, {"estimator": describe(estimators()[1])})
    with pytest.raises(PoseDataError, match=r"1 missing \(flow\.embedding\.adjacency\)"):
        load_estimator(tmp_path / "w.safetensors")


@pytest.mark.parametrize("cut", [0, 5, 300, -1])
def test_damaged_weights_are_refused(tmp_path, cut):
    save_estimator(tmp_path / "w.safetensors", estimators()[1])
    content = (tmp_path / "w.safetensors").read_bytes()
    (tmp_path / "w.safetensors").write_bytes(content[:cut])
    with pytest.raises(PoseFileError, match=r"w\.safetensors: damaged or no safetensors file"):
        load_estimator(tmp_path / "w.safetensors")


def edited(path, about=None, **entries):
    """Write other words into the header of a weights file."""
    content = path.read_bytes()
    length = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + length])
    if about is not None:
        stored = json.loads(header["__metadata__"]["posecal"])
        header["__metadata__"]["posecal"] = json.dumps(about(stored) or stored)
    for name, entry in entries.items():
        header[name].update(entry)
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + content[8 + length :])


@pytest.mark.parametrize(
    ("about", "entries", "words"),
    [
        (lambda about: about["notes"].update(poses=13), {}, "its numbers differ from those that were written"),
        (lambda about: about.pop("digest") and None, {}, "its numbers differ from those that were written"),
        (lambda about: [1, 2], {}, "damaged or no safetensors file"),
        (None, {"last.bias": {"dtype": "I32"}}, "its numbers differ from those that were written"),
    ],
    ids=["notes", "no digest", "a list", "another type"],
)
def test_an_edited_header_is_noticed(tmp_path, about, entries, words):
    save_estimator(tmp_path / "w.safetensors", estimators()[2], notes={"poses": 12})
    edited(tmp_path / "w.safetensors", about, **entries)
    with pytest.raises(PoseFileError, match=rf"w\.safetensors: .*{words}"):
        load_estimator(tmp_path / "w.safetensors")


def test_the_same_weights_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        save_estimator(tmp_path / f"{name}.safetensors", estimators()[2], notes={"poses": 12})
    assert (tmp_path / "a.safetensors").read_bytes() == (tmp_path / "b.safetensors").read_bytes()


@pytest.mark.parametrize("key", ["width", "residuals"])
def test_a_description_of_millions_of_weights_is_refused_before_they_take_memory(tmp_path, key):
    estimator = estimators()[2]
    about = {"estimator": {**describe(estimator), key: 10**7}, "notes": {}}
    write_tensors(tmp_path / "w.safetensors", estimator.state_dict(), about)
    with pytest.raises(PoseDataError, match=r"weights don't fit the estimator: a size of 10,000,000; expected at most"):
        load_estimator(tmp_path / "w.safetensors")


def test_a_single_flipped_bit_is_noticed(tmp_path):
    save_estimator(tmp_path / "w.safetensors", estimators()[1])
    content = bytearray((tmp_path / "w.safetensors").read_bytes())
    content[-6] ^= 1
    (tmp_path / "w.safetensors").write_bytes(content)
    with pytest.raises(
        PoseFileError, match=r"w\.safetensors: damaged: its numbers differ from those that were written"
    ):
        load_estimator(tmp_path / "w.safetensors")


def test_other_safetensors_are_refused(tmp_path):
    save_file({"weight": torch.zeros(3)}, tmp_path / "w.safetensors")
    with pytest.raises(PoseFileError, match="without the header of posecal"):
        load_estimator(tmp_path / "w.safetensors")


def format_1(path: Path) -> dict[str, torch.Tensor]:
    """Write weights in format 1, whose tensors of a cGNF's blocks were stacked; return them as they are now."""
    estimator = CGNF(FlowSize(2, 4, 3, 5))
    for parameter in estimator.parameters():
        parameter.data.normal_()
    state, stacked = estimator.state_dict(), {}
    for name, tensor in state.items():
        if name.startswith("flow.blocks.0."):
            other = state[name.replace("blocks.0", "blocks.1")]
            short = name.removeprefix("flow.blocks.0.")
            stacked[f"flow.couplings.{'' if '.' in short else 'actnorm_'}{short}"] = torch.stack([tensor, other])
        elif not name.startswith("flow.blocks."):
            stacked[name] = tensor
    about = {"version": "0.1.0", "estimator": describe(estimator), "notes": {"poses": 3}}
    header = json.dumps({**about, "digest": _digest(stacked, json.dumps(about))})
    save_file(stacked, path, metadata={"posecal": header})
    return state


def test_weights_of_format_1_are_refused_and_can_be_converted(tmp_path):
    state = format_1(tmp_path / "old.safetensors")
    with pytest.raises(PoseFileError, match=r"old\.safetensors: of format 1; expected 2\. Convert weights with"):
        load_estimator(tmp_path / "old.safetensors")
    convert_format_1(tmp_path / "old.safetensors", tmp_path / "new.safetensors")
    found = load_estimator(tmp_path / "new.safetensors").state_dict()
    assert sorted(found) == sorted(state)
    for name, tensor in state.items():
        assert torch.equal(found[name], tensor), name
    assert notes_of(tmp_path / "new.safetensors") == {"poses": 3}
    with pytest.raises(PoseDataError, match=r"new\.safetensors: holds no weights of format 1"):
        convert_format_1(tmp_path / "new.safetensors", tmp_path / "again.safetensors")


def test_weights_of_a_later_format_are_refused(tmp_path):
    write_tensors(tmp_path / "w.safetensors", {"a": torch.zeros(1)}, {"format": 3})
    with pytest.raises(PoseFileError, match=r"of format 3; expected 2\. Use the version of posecal that wrote it"):
        load_estimator(tmp_path / "w.safetensors")


def test_missing_weights_are_named():
    with pytest.raises(PoseFileError, match=r"nowhere\.safetensors: no such weights"):
        load_estimator("nowhere.safetensors")


def test_a_description_of_something_else_is_refused():
    with pytest.raises(PoseDataError, match="weights: of 'vae'; expected cgnf"):
        build({"kind": "vae"})
    with pytest.raises(PoseDataError, match="incomplete or invalid description"):
        build({"kind": "cgnf"})


def test_weights_written_again_are_the_same_file(tmp_path):
    estimator, path = estimators()[0], tmp_path / "w.safetensors"
    written = set()
    for _ in range(12):  # by chance the same in 1 of 2,048 cases
        save_estimator(path, estimator, notes={"trained by": "Käthe"})
        written.add(path.read_bytes())
    assert len(written) == 1
    content = written.pop()
    assert int.from_bytes(content[:8], "little") % 8 == 0
    assert notes_of(path) == {"trained by": "Käthe"}


@pytest.mark.slow
def test_a_full_disk_leaves_what_was_there(tmp_path):
    """In a process of its own whose files may not grow beyond 20 kB, as on a disk without space."""
    write_tensors(tmp_path / "w.safetensors", {"a": torch.zeros(10)}, {"estimator": {}})
    before = (tmp_path / "w.safetensors").read_bytes()
    script = """
import resource, signal, sys, torch
from posecal.errors import PoseFileError
from posecal_models.checkpoint import write_tensors
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    write_tensors(sys.argv[1], {"a": torch.zeros(100_000)}, {})
except PoseFileError as problem:
    print(problem)
"""
    assert resource.RLIMIT_FSIZE is not None
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path / "w.safetensors")],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        check=True,
    )
    assert "w.safetensors: can't be written (File too large)" in done.stdout
    assert (tmp_path / "w.safetensors").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["w.safetensors"]
