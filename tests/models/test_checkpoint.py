"""Weights files: round trips, and errors for invalid ones."""

from __future__ import annotations

import json
import os
import pickle
import resource
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import (
    _digest,
    convert_format_1,
    load_estimator,
    load_released,
    named_weights,
    notes_of,
    read_tensors,
    resolve_device,
    save_estimator,
    write_tensors,
)
from posecal_models.config import Config
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
from tests.models.random_flows import with_hip_keypoint

ROOT = Path(__file__).parents[2]
REFERENCE = Path(__file__).parents[1] / "fixtures" / "reference_models"


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


def test_a_number_of_thousands_of_digits_is_no_setting(tmp_path):
    (tmp_path / "a.toml").write_text("[train]\nepochs = 0x" + "f" * 4000)
    with pytest.raises(PoseFileError, match=r"a\.toml: not valid TOML \(Exceeds the limit"):
        Config.load(str(tmp_path / "a.toml"))


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


# --- released checkpoints ---------------------------------------------------------------------------------------


def released_state() -> dict[str, torch.Tensor]:
    with np.load(REFERENCE / "tiny_state.npz") as file:
        return {name: torch.from_numpy(file[name]) for name in file.files}


def test_a_released_checkpoint_loads_and_its_dead_tensors_are_listed(tmp_path):
    torch.save(released_state(), tmp_path / "model.pt")
    estimator, unused = load_released(tmp_path / "model.pt")
    assert estimator.size == FlowSize(blocks=2, hidden=8, context=4, embedding=16)
    assert {name.split("layers.", 1)[1].removesuffix(".weight").removesuffix(".bias") for name in unused} == {
        "0.layers.x<-x",
        "1.layers.x<-x",
        "1.layers.c",
        "1.layers.r",
        "0.attention",
        "1.attention",
    }
    with np.load(REFERENCE / "tiny_io.npz") as numbers:
        keypoints = torch.from_numpy(numbers["c"]) / 0.0139
        poses = torch.from_numpy(numbers["x"]) / 0.0036
        context = with_hip_keypoint(keypoints, torch.from_numpy(numbers["mask_part"]))
        # density in mm: that of the scaled pose, and 48 times the log of the scale
        expected = numbers["part/logp_pose"] + 48 * np.log(0.0036)
    np.testing.assert_allclose(estimator(context).log_prob(poses).detach(), expected, rtol=1e-5)


def test_a_hostile_checkpoint_is_refused_and_runs_nothing(tmp_path):
    class Runs:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "it ran"),)

    torch.save({"weight": Runs()}, tmp_path / "model.pt")
    with pytest.raises(PoseFileError, match=r"model\.pt: holds more than tensors"):
        load_released(tmp_path / "model.pt")
    assert not (tmp_path / "it ran").exists()


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        ({"conv.weight": torch.zeros(1)}, PoseDataError, r"1 tensor is not part of a cGNF \(conv\.weight\)"),
        ({"_embedding_net.adj": torch.zeros(2, 2)}, PoseFileError, "lacks 'blocks"),
        ([1, 2], PoseDataError, "holds no state_dict"),
    ],
)
def test_a_checkpoint_of_something_else_is_refused(tmp_path, content, error, words):
    torch.save(content, tmp_path / "model.pt")
    with pytest.raises(error, match=words):
        load_released(tmp_path / "model.pt")


def test_a_checkpoint_with_another_number_of_blocks_is_refused(tmp_path):
    torch.save(released_state(), tmp_path / "model.pt")
    with pytest.raises(PoseDataError, match=r"model\.pt: 2 blocks; expected 10"):
        load_released(tmp_path / "model.pt", blocks=10)


def test_a_pickle_that_is_no_checkpoint_is_refused(tmp_path):
    (tmp_path / "model.pt").write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises((PoseFileError, PoseDataError), match=r"model\.pt"):
        load_released(tmp_path / "model.pt")


# --- the weights that come with the package ----------------------------------------------------------------------

WEIGHTS = ROOT / "posecal_models" / "weights"


@pytest.mark.parametrize(("name", "size"), [("cgnf-small", 5e6), ("reference", 10e6)])
def test_named_weights_are_small_and_have_their_card(name, size):
    assert named_weights() == ("cgnf-small", "reference")
    assert (WEIGHTS / f"{name}.safetensors").stat().st_size < size
    card = " ".join((WEIGHTS / f"{name}.md").read_text(encoding="utf-8").split())
    for words in (
        "The data used in this project was obtained from mocap.cs.cmu.edu.",
        "The database was created with funding from NSF EIA-0196217.",
        ", ".join(load_estimator(name).joints),
        "Cameras",
        "Limits",
    ):
        assert words in card


def test_the_small_cgnf_s_prior_stands_upright_and_varies():
    estimator = load_estimator("cgnf-small")
    assert isinstance(estimator, CGNF)
    notes = read_tensors(WEIGHTS / "cgnf-small.safetensors")[1]["notes"]
    assert notes["config"]["data"]["test_subjects"] == ["S3", "S6", "S49"]
    poses = estimator.prior(3).sample(20, generator=torch.Generator().manual_seed(0))
    assert poses.isfinite().all()
    # y points down: the head of a grown person is half a metre and more above the hip, the feet as much below it
    heights = dict(zip(estimator.joints, poses[..., 1].flatten(0, 1).median(0).values.tolist(), strict=True))
    assert -900 < heights["Head"] < -300
    assert 500 < heights["RFoot"] < 1100
    assert poses.std(0).mean() > 10
