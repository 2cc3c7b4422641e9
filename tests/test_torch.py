"""The metric of torchmetrics: what its base class promises, and the numbers of one call."""

from __future__ import annotations

import copy
import importlib
import pickle
import sys
from typing import Any

import pytest

import posecal
from posecal.errors import PoseDataError

torch = pytest.importorskip("torch")
torchmetrics = pytest.importorskip("torchmetrics")

from posecal.torch import PoseMetric  # noqa: E402

N, M, K = 6, 40, 4
OPTIONS: dict[str, Any] = {"unit": "mm", "axes": "MNKD", "metrics": ["min_mpjpe", "mpjpe", "ece", "ause"]}
BATCHES = (slice(0, 15), slice(15, 18), slice(18, M))


@pytest.fixture(scope="module")
def poses() -> dict[str, Any]:
    """Hypotheses and truth of four clips of ten frames, with frame ids."""
    random = torch.Generator().manual_seed(3)
    truth = 300 * torch.randn(M, K, 3, generator=random)
    hypotheses = truth[:, None] + 50 * torch.randn(M, N, K, 3, generator=random)
    clips = [f"clip {i // 10}" for i in range(M)]
    return {"hypotheses": hypotheses, "truth": truth, "sequence": clips, "frame_id": torch.arange(M)}


def new(**options: Any) -> PoseMetric:
    return PoseMetric(posecal.Evaluation(**OPTIONS), **options)


def batch(poses: dict[str, Any], part: slice, *, frames: bool = False) -> tuple[tuple[Any, Any], dict[str, Any]]:
    described = {"sequence": poses["sequence"][part]} | ({"frame_id": poses["frame_id"][part]} if frames else {})
    return (poses["hypotheses"][part], poses["truth"][part]), described


def updated(poses: dict[str, Any], *parts: slice, frames: bool = False, **options: Any) -> PoseMetric:
    metric = new(**options)
    for part in parts:
        arrays, described = batch(poses, part, frames=frames)
        metric.update(*arrays, **described)
    return metric


def expected(poses: dict[str, Any], part: slice = slice(None)) -> dict[str, float]:
    labels = {"sequence": poses["sequence"][part]}
    return posecal.evaluate(poses["hypotheses"][part], poses["truth"][part], labels=labels, **OPTIONS).scalars()


def assert_numbers(found: dict[str, Any], numbers: dict[str, float], rel: float = 1e-6) -> None:
    assert list(found) == list(numbers)
    for name, value in found.items():
        assert value.shape == ()
        assert value.item() == pytest.approx(numbers[name], rel=rel), name


# --- update, compute, reset, forward --------------------------------------------------------------------------


def test_batches_give_the_numbers_of_one_call(poses: dict[str, Any]) -> None:
    metric = updated(poses, *BATCHES)
    assert_numbers(metric.compute(), expected(poses))
    report = metric.report()
    assert report.scalars() == pytest.approx(expected(poses), rel=1e-12)
    assert report.interval("mpjpe")[0] < report["mpjpe"] < report.interval("mpjpe")[1]


def test_a_number_that_was_computed_does_not_outlive_the_next_batch(poses: dict[str, Any]) -> None:
    metric = updated(poses, BATCHES[0])
    assert_numbers(metric.compute(), expected(poses, BATCHES[0]))
    arrays, described = batch(poses, slice(15, M))
    metric.update(*arrays, **described)
    assert_numbers(metric.compute(), expected(poses))


def test_a_call_gives_the_numbers_of_its_batch_and_counts_it_once(poses: dict[str, Any]) -> None:
    metric = new()
    for part in BATCHES:
        arrays, described = batch(poses, part, frames=True)
        assert_numbers(metric(*arrays, **described), expected(poses, part))
    assert_numbers(metric.compute(), expected(poses))
    assert metric.update_count == len(BATCHES)


def test_reset_forgets_all_batches(poses: dict[str, Any]) -> None:
    metric = updated(poses, BATCHES[0])
    metric.reset()
    assert not metric.update_called
    with pytest.raises(PoseDataError, match="no batch so far"), pytest.warns(UserWarning, match="before the"):
        metric.compute()
    arrays, described = batch(poses, slice(0, M))
    metric.update(*arrays, **described)
    assert_numbers(metric.compute(), expected(poses))


def test_the_evaluation_that_is_passed_stays_as_it_is(poses: dict[str, Any]) -> None:
    evaluation = posecal.Evaluation(**OPTIONS)
    arrays, described = batch(poses, BATCHES[0])
    evaluation.update(*arrays, **described)
    one, other = PoseMetric(evaluation), PoseMetric(evaluation)
    one.update(*arrays, **described)
    assert one.report().totals.poses.sum() == evaluation.compute().totals.poses.sum() == 15
    with pytest.raises(PoseDataError, match="no batch so far"):
        other.report()
    with pytest.raises(PoseDataError, match=r"^evaluation: dict; expected Evaluation\.$"):
        PoseMetric({"unit": "mm"})  # type: ignore[arg-type]


# --- copies, files, types -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "copied",
    [lambda m: pickle.loads(pickle.dumps(m)), lambda m: m.clone(), copy.deepcopy],
    ids=["pickle", "clone", "deepcopy"],
)
def test_a_copy_goes_on_by_itself(poses: dict[str, Any], copied: Any) -> None:
    metric = updated(poses, BATCHES[0])
    other = copied(metric)
    arrays, described = batch(poses, slice(15, M))
    other.update(*arrays, **described)
    assert_numbers(other.compute(), expected(poses))
    assert_numbers(metric.compute(), expected(poses, BATCHES[0]))
    assert hash(other) != hash(metric) == hash(metric)


def test_nothing_of_it_is_in_a_state_dict(poses: dict[str, Any]) -> None:
    module = torch.nn.ModuleDict({"metric": updated(poses, BATCHES[0]), "layer": torch.nn.Linear(1, 1)})
    assert sorted(module.state_dict()) == ["layer.bias", "layer.weight"]
    module.load_state_dict(module.state_dict())
    assert module["metric"].update_count == 1
    module["metric"].persistent(False)
    with pytest.raises(PoseDataError, match=r"^persistent: True; expected False\. .*report\(\)\.save"):
        module["metric"].persistent(True)


@pytest.mark.parametrize(
    ("move", "dtype"),
    [
        (lambda m: m.to("cpu"), torch.float32),
        (lambda m: m.half(), torch.float32),
        (lambda m: m.set_dtype(torch.float64), torch.float64),
        (lambda m: m.set_dtype(torch.bfloat16).set_dtype(torch.float64), torch.float64),
    ],
    ids=["device", "half", "set_dtype", "bfloat16"],
)
def test_a_type_is_that_of_the_numbers_and_never_of_the_sums(poses: dict[str, Any], move: Any, dtype: Any) -> None:
    metric = move(updated(poses, BATCHES[0]))
    arrays, described = batch(poses, slice(15, M))
    metric.update(*arrays, **described)
    numbers = metric.compute()
    assert {value.dtype for value in numbers.values()} == {dtype}
    assert_numbers(numbers, expected(poses), rel=1e-12 if dtype == torch.float64 else 1e-6)


def test_batches_survive_a_move_of_states_to_the_host(poses: dict[str, Any]) -> None:
    assert_numbers(updated(poses, *BATCHES, compute_on_cpu=True).compute(), expected(poses))


def test_tensors_may_require_gradients_and_be_half_precision(poses: dict[str, Any]) -> None:
    arrays, described = batch(poses, slice(0, M))
    metric = new()
    metric.update(arrays[0].clone().requires_grad_(), arrays[1].to(torch.bfloat16), **described)
    numbers = metric.compute()
    assert not any(value.requires_grad for value in numbers.values())
    assert numbers["mpjpe"].item() == pytest.approx(expected(poses)["mpjpe"], rel=1e-2)


def test_its_properties_are_those_of_a_class() -> None:
    metric = new()
    for name in ("is_differentiable", "higher_is_better", "full_state_update"):
        with pytest.raises(RuntimeError, match="Can't change const"):
            setattr(metric, name, True)
    assert metric.is_differentiable is False
    assert metric.higher_is_better is None
    with pytest.raises(ValueError, match="Unexpected keyword arguments: `metric`"):
        new(metric="ece")


# --- several metrics, several processes -----------------------------------------------------------------------


class Poses(torchmetrics.Metric):  # type: ignore[misc]
    """Number of poses: a metric that knows no labels."""

    full_state_update = False

    def __init__(self) -> None:
        super().__init__()
        self.add_state("number", default=torch.tensor(0), dist_reduce_fx="sum")

    def update(self, hypotheses: Any, truth: Any) -> None:
        self.number += len(truth)

    def compute(self) -> Any:
        return self.number


def test_a_collection_gives_the_numbers_of_each_metric(poses: dict[str, Any]) -> None:
    names = ("mpjpe", "ece", "mpjpe")
    own = {f"of {i}": PoseMetric(posecal.Evaluation(unit="mm", axes="MNKD", metrics=n)) for i, n in enumerate(names)}
    collection = torchmetrics.MetricCollection({**own, "poses": Poses()}, prefix="validation/")
    for part in BATCHES:
        arrays, described = batch(poses, part)
        collection.update(*arrays, **described)
    numbers = collection.compute()
    assert numbers.pop("validation/poses") == M
    assert {name.removeprefix("validation/"): value.item() for name, value in numbers.items()} == pytest.approx(
        {
            "of 0_mpjpe": expected(poses)["mpjpe"],
            "of 1_ece": expected(poses)["ece"],
            "of 2_mpjpe": expected(poses)["mpjpe"],
        }
    )
    collection.reset()
    collection.update(*batch(poses, BATCHES[0])[0])
    assert collection.compute()["validation/of 2_mpjpe"].item() == pytest.approx(expected(poses, BATCHES[0])["mpjpe"])


@pytest.mark.parametrize("of", [lambda m: m, lambda m: m.metric_state], ids=["metric", "state"])
def test_metrics_are_merged(poses: dict[str, Any], of: Any) -> None:
    one, other = updated(poses, BATCHES[0]), updated(poses, slice(15, M))
    one.compute()
    one.merge_state(of(other))
    assert_numbers(one.compute(), expected(poses))
    assert_numbers(other.compute(), expected(poses, slice(15, M)))


def test_metrics_that_do_not_fit_are_not_merged(poses: dict[str, Any]) -> None:
    metric = updated(poses, BATCHES[0])
    with pytest.raises(PoseDataError, match="hold the same poses: 5 with"):
        metric.merge_state(updated(poses, slice(10, 20)))
    with pytest.raises(PoseDataError, match=r"^incoming_state: Poses; expected a PoseMetric, or its metric_state\.$"):
        metric.merge_state(Poses())
    assert_numbers(metric.compute(), expected(poses, BATCHES[0]))


def gathered_with(*others: PoseMetric) -> dict[str, Any]:
    """Options of a metric of the first of several processes, where those of the others are at hand."""

    def gather(state: Any, group: Any) -> list[Any]:
        return [state, *(other.state[0] for other in others)]

    return {"dist_sync_fn": gather, "distributed_available_fn": lambda: True}


def test_processes_are_put_together_and_go_on_apart(poses: dict[str, Any]) -> None:
    metric = updated(poses, BATCHES[0], **gathered_with(updated(poses, slice(15, 30)), updated(poses, slice(30, M))))
    assert_numbers(metric.compute(), expected(poses))
    assert metric.report().scalars() == pytest.approx(expected(poses), rel=1e-12)
    metric.sync(dist_sync_fn=metric.dist_sync_fn)
    assert metric.evaluation.compute().totals.poses.sum() == M
    metric.unsync()
    assert metric.evaluation.compute().totals.poses.sum() == 15
    assert_numbers(metric(*batch(poses, slice(15, 18))[0], sequence="clip 1"), expected(poses, slice(15, 18)))


def test_numbers_of_a_batch_may_be_those_of_all_processes(poses: dict[str, Any]) -> None:
    metric = new(dist_sync_on_step=True, **gathered_with(updated(poses, slice(20, M))))
    arrays, described = batch(poses, slice(0, 20))
    assert_numbers(metric(*arrays, **described), expected(poses))


def test_a_process_may_have_no_batch(poses: dict[str, Any]) -> None:
    assert_numbers(updated(poses, *BATCHES, **gathered_with(new())).compute(), expected(poses))
    metric = new(**gathered_with(updated(poses, *BATCHES)))
    with pytest.warns(UserWarning, match="before the"):
        assert_numbers(metric.compute(), expected(poses))


@pytest.mark.parametrize("call", ["compute", "report"])
@pytest.mark.filterwarnings("ignore:The ``compute`` method")  # before update
def test_a_refused_compute_leaves_a_metric_that_goes_on(poses: dict[str, Any], call: str) -> None:
    metric = new(**gathered_with(new()))
    with pytest.raises(PoseDataError, match=r"^evaluation: no batch so far"):
        getattr(metric, call)()
    for part in BATCHES:
        metric.update(*batch(poses, part)[0], **batch(poses, part)[1])
    assert_numbers(metric.compute(), expected(poses))


def test_frames_that_a_sampler_repeats_are_counted_once(poses: dict[str, Any]) -> None:
    """Process 0 has 14, 13 and 13 poses; process 1 has one of them again, as a sampler pads its share."""
    others = {name: values[26:] for name, values in poses.items()}
    padded = {
        name: values + poses[name][:2] if isinstance(values, list) else torch.cat([values, poses[name][:2]])
        for name, values in others.items()
    }
    other = updated(padded, slice(0, 10), slice(10, 16), frames=True)
    metric = updated(poses, slice(0, 14), slice(14, 26), frames=True, **gathered_with(other))
    assert_numbers(metric.compute(), expected(poses))
    assert any("2 poses came more than once" in remark for remark in metric.report().remarks)


# --- what can't be --------------------------------------------------------------------------------------------


def test_functions_that_can_not_be_sent_are_refused_where_they_are_sent(poses: dict[str, Any]) -> None:
    evaluation = posecal.Evaluation(unit="mm", axes="MNKD", preranks={"first": lambda pool: pool[:, 0, 0]})
    metric, (arrays, described) = PoseMetric(evaluation), batch(poses, BATCHES[0])
    metric.update(*arrays, **described)
    assert metric.compute()["mpjpe"] > 0
    with pytest.raises(PoseDataError, match=r"^evaluation: can't be sent .*; expected preranks and metrics whose"):
        metric(*arrays, **described)


def test_a_batch_that_is_refused_is_not_counted(poses: dict[str, Any]) -> None:
    metric = updated(poses, BATCHES[0])
    with pytest.raises(PoseDataError, match=r"^batch 2: n_hypotheses 5 against 6"):
        metric.update(poses["hypotheses"][15:, :5], poses["truth"][15:], sequence="clip 2")
    assert_numbers(metric.compute(), expected(poses, BATCHES[0]))


def test_what_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "posecal.torch")
    monkeypatch.setitem(sys.modules, "torchmetrics", None)
    with pytest.raises(ImportError, match=r"^posecal\.torch: needs torchmetrics, .* pip install 'posecal\[torch\]'"):
        importlib.import_module("posecal.torch")
