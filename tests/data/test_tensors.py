"""PyTorch's tensors are measured as arrays, wherever they are and whatever their type."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import posecal
from posecal.data.arguments import checked
from posecal.data.arrays import as_array, as_labels, checked_number, checked_root
from posecal.data.pose_data import PoseData
from posecal.errors import PoseDataError
from posecal.metrics import min_mpjpe
from tests.helpers.random_worlds import Array, mostly, skewed
from tests.helpers.small_files import coordinates, hypotheses, truth

torch = pytest.importorskip("torch")

N, M, K = 5, 7, 4
OCCLUDED = np.arange(7 * 17).reshape(7, 17) % 5 == 0
SCORES = np.arange(5.0 * 7).reshape(5, 7)


@pytest.fixture
def arrays() -> tuple[Array, Array]:
    return skewed(1, N, M, K)


class OnDevice:
    """A tensor that must leave its graph and its device before it can be read."""

    def __init__(self, tensor: Any, place: str = "graph") -> None:
        self.tensor, self.place = tensor, place

    def detach(self) -> OnDevice:
        return OnDevice(self.tensor, "device")

    def cpu(self) -> Any:
        if self.place != "device":
            raise RuntimeError("still on the graph")
        return self.tensor

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise TypeError("can't convert a device tensor")


@pytest.mark.parametrize(
    "convert",
    [
        torch.tensor,
        lambda x: torch.tensor(x, requires_grad=True) * 1,
        lambda x: torch.tensor(np.asfortranarray(x)).swapaxes(0, 1).contiguous().swapaxes(0, 1),
        lambda x: torch._neg_view(torch.tensor(-x)),
        lambda x: OnDevice(torch.tensor(x)),
        lambda x: [torch.tensor(part, requires_grad=True) for part in x],
    ],
    ids=["tensor", "graph", "strided", "negated", "device", "tensors"],
)
def test_tensors_are_measured_as_arrays(convert: Any, arrays: tuple[Array, Array]) -> None:
    where = mostly(M, K)
    expected = min_mpjpe(*arrays, where=where, root=1)
    np.testing.assert_array_equal(min_mpjpe(*map(convert, arrays), where=torch.tensor(where), root=1), expected)


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float16, torch.float8_e4m3fn])
def test_tensors_of_few_bits_are_measured_in_single(dtype: Any, arrays: tuple[Array, Array]) -> None:
    tensors = [torch.tensor(array / 4).to(dtype) for array in arrays]
    singles = [tensor.float().numpy() for tensor in tensors]
    for tensor, single in zip(tensors, singles, strict=True):
        found = as_array(tensor, "truth")
        assert found.dtype == np.float32
        np.testing.assert_array_equal(found, single)
    np.testing.assert_array_equal(min_mpjpe(*tensors), min_mpjpe(*singles))


def test_whole_numbers_and_truth_values_stay_what_they_are() -> None:
    assert as_array(torch.tensor([1, 2]), "sizes").dtype == np.int64
    assert as_array(torch.tensor([True]), "where").dtype == bool


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ([torch.zeros(2), torch.zeros(3)], "truth: lists of unequal lengths; expected an array."),
        (torch.zeros(3, device="meta"), "truth: a Tensor that can't be read ("),
        (torch.zeros(3, 3).to_sparse(), "truth: a Tensor that can't be read ("),
        (torch.zeros(3, dtype=torch.complex64), "truth: dtype complex64; expected real numbers such as float32."),
        (torch.zeros(3, dtype=torch.complex64).conj(), "truth: a Tensor that can't be read ("),
        (torch.zeros(3, dtype=torch.bool), "truth: dtype bool; expected real numbers such as float32."),
    ],
    ids=str,
)
def test_a_tensor_that_can_not_be_read_is_one_clear_error(values: Any, words: str) -> None:
    with pytest.raises(PoseDataError, match=f"^{re.escape(words)}"):
        checked(np.zeros((2, 3, 4, 3)), values)


def test_a_tensor_in_memory_is_not_copied(arrays: tuple[Array, Array]) -> None:
    tensor = torch.tensor(arrays[0])
    assert as_array(tensor, "hypotheses").ctypes.data == tensor.data_ptr()


def test_single_values_and_words_may_be_tensors() -> None:
    assert checked_root(torch.tensor(-1), K) == K - 1
    assert checked_number(torch.tensor(2.5), "threshold", lambda length: length > 0, "a length above 0") == 2.5
    assert as_labels(torch.tensor([3, 1]), "take").tolist() == ["3", "1"]
    assert PoseData(hypotheses(), truth()).select(torch.tensor([5, 1])).order.tolist() == [5, 1]


def test_pose_data_takes_tensors() -> None:
    expected = PoseData(hypotheses(), truth(), where=~OCCLUDED, scores=SCORES, occluded=OCCLUDED, frame_id=range(7))
    tensors = PoseData(
        torch.tensor(hypotheses(), requires_grad=True),
        torch.tensor(truth()),
        where=torch.tensor(~OCCLUDED),
        scores=torch.tensor(SCORES, requires_grad=True),
        occluded=torch.tensor(OCCLUDED),
        frame_id=torch.arange(7),
    )
    np.testing.assert_array_equal(coordinates(tensors), coordinates(expected))
    for name in ("truth", "where", "scores", "occluded", "frame_id"):
        np.testing.assert_array_equal(getattr(tensors, name), getattr(expected, name))


class Distant:
    """A tensor of another device, which says how many bytes were copied from it at most."""

    device = SimpleNamespace(type="cuda")
    most = 0

    def __init__(self, tensor: Any) -> None:
        self.tensor, self.shape, self.nbytes = tensor, tensor.shape, tensor.nbytes

    def __getitem__(self, where: Any) -> Distant:
        return Distant(self.tensor[where])

    def detach(self) -> Distant:
        return self

    def cpu(self) -> Any:
        Distant.most = max(Distant.most, self.nbytes)
        return self.tensor


def test_a_large_tensor_of_another_device_is_copied_some_poses_at_a_time(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (4000, 5, 3)).astype(np.float32)
    x = torch.tensor(y[:, None] + random.normal(0, 50, (4000, 20, 5, 3))).bfloat16()
    options: dict[str, Any] = {"unit": "mm", "axes": "MNKD", "threads": 1}
    expected = posecal.evaluate(x, y, **options).scalars()
    monkeypatch.setattr("posecal.data.lazy._COPIED", x.nbytes - 1)
    monkeypatch.setattr("posecal.engine.chunks.WINDOW_BYTES", x.nbytes // 3)
    monkeypatch.setattr(Distant, "most", 0)
    assert posecal.evaluate(Distant(x), y, **options).scalars() == pytest.approx(expected, rel=1e-12)
    assert 0 < Distant.most < x.nbytes / 2
    monkeypatch.setattr("posecal.data.lazy._COPIED", x.nbytes)  # which one copy takes at once
    posecal.evaluate(Distant(x), y, **options)
    assert Distant.most == x.nbytes


def test_a_large_tensor_of_another_device_that_holds_no_real_numbers_is_refused() -> None:
    tensor = torch.zeros(5_000_000, dtype=torch.complex64)
    with pytest.raises(PoseDataError, match=r"^hypotheses: dtype complex64; expected real numbers such as float32"):
        PoseData(Distant(tensor), truth())  # type: ignore[arg-type]


def test_a_half_precision_tensor_is_measured_in_single() -> None:
    data = PoseData(torch.tensor(hypotheses()).bfloat16(), torch.tensor(truth()).half())
    assert coordinates(data).dtype == data.truth.dtype == np.float32
    np.testing.assert_allclose(coordinates(data), hypotheses(), atol=4)  # eight bits of up to 1,024 mm
