"""Metrics: their statistics and definitions, and metrics of functions of arrays."""

from __future__ import annotations

import pickle
from typing import Any, get_args

import numpy as np
import numpy.typing as npt
import pytest

import posecal
from posecal.data.skeleton import JOINT_SETS
from posecal.engine.block import Block
from posecal.engine.finish import entry, mean_over_joints, per_joint
from posecal.engine.metric import Deviation, Direction, Family, Metric, Statistic
from posecal.engine.protocol import Protocol
from posecal.engine.scope import DataSpec
from posecal.errors import PoseDataError
from posecal.registry import known_metrics
from tests.helpers.random_worlds import skewed

Array = npt.NDArray[np.floating]
Mask = npt.NDArray[np.bool_]

H36M = JOINT_SETS["h36m-17"]
PERSON = DataSpec(5, H36M, 0, ("sequence",), 25.0, True)


def test_an_entry_is_read_from_the_means_of_any_number_of_resamples() -> None:
    assert entry()(np.array(2.5)) == 2.5
    assert entry(1)(np.array([2.5, 3.5])) == 3.5
    means = np.arange(24.0).reshape(4, 2, 3)
    np.testing.assert_array_equal(entry(1, 2)(means), means[:, 1, 2])
    np.testing.assert_array_equal(per_joint(2)(means), means[:, :, 2])
    np.testing.assert_array_equal(per_joint()(means), means)


def test_a_mean_over_joints_is_of_those_that_count() -> None:
    values = np.array([[1.0, np.nan, 3], [np.nan] * 3, [4, 5, 6], [np.nan, 7, np.nan]])
    np.testing.assert_array_equal(mean_over_joints(values), [2, np.nan, 5, 7])


def test_a_metric_s_statistics_are_those_of_its_number_and_of_its_joints() -> None:
    def first(block: Block) -> np.ndarray:
        return block.truth[:, 0, 0]

    one, two = Statistic("one", first), Statistic("two", first, per_joint=True)
    words = dict.fromkeys(("name", "label", "unit", "brief", "definition"), "")
    metric = Metric(**words, direction="none", family="sharpness", statistic=one, finish=entry())
    assert metric.statistics == (one,)
    assert not metric.headline
    metric = Metric(
        **words, direction="none", family="sharpness", statistic=one, finish=entry(), by_joint=(two, np.asarray)
    )
    assert metric.statistics == (one, two)


PROTOCOLS = [
    Protocol(),
    Protocol(best="joint", where="occluded", pck_best="linked", pck_rule="<=", auc="integral", cps_unit="share"),
    Protocol(best="sequence", align="rigid", scale="rms_mean", cps_align="none", cps_best="mean", mode="0"),
    Protocol(best="batch:3", align="reflection", align_best="own", velocity="second", deviation="population"),
    Protocol(align_best="linked", scale="norm_root", root="drop", ece_over="worst"),
]


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_metric_can_be_read(protocol: Protocol) -> None:
    for name, metric in known_metrics(protocol, PERSON).items():
        assert name == metric.name
        assert name.isidentifier()
        assert name == name.lower()
        assert metric.label
        assert metric.brief
        assert metric.unit in {"", "mm", *(f"mm/{of}{power}" for of in ("frame", "s") for power in ("", "²", "³"))}
        assert metric.direction in get_args(Direction)
        assert metric.family in get_args(Family)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_every_definition_is_one_line_that_says_what_it_is_over(protocol: Protocol) -> None:
    for metric in known_metrics(protocol, PERSON).values():
        assert "\n" not in metric.definition
        assert "joint" in metric.definition or "hypotheses" in metric.definition, metric.name


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_statistics_of_one_name_are_one_statistic(protocol: Protocol) -> None:
    """Sums are kept by name: two statistics that share one would be added to each other."""
    random = np.random.default_rng(0)
    y = random.normal(0, 300, (4, 17, 3))
    block = Block(y + random.normal(0, 50, (5, 4, 17, 3)), y, root=0, scores=random.random((5, 4)))
    found: dict[str, np.ndarray] = {}
    for metric in known_metrics(protocol, PERSON).values():
        for statistic in metric.statistics:
            values = statistic.compute(block)
            np.testing.assert_array_equal(values, found.setdefault(statistic.name, values), err_msg=statistic.name)


def test_two_numbers_never_share_a_definition() -> None:
    for protocol in PROTOCOLS:
        definitions = [metric.definition for metric in known_metrics(protocol, PERSON).values()]
        assert len(set(definitions)) == len(definitions)


# --- metrics of functions of arrays ---------------------------------------------------------------------------------


def depth_error(hypotheses: Array, truth: Array) -> Array:
    """Mean absolute error along the third axis.

    In mm.
    """
    return np.abs(hypotheses - truth)[..., 2].mean(axis=(0, 2))


def worst_joint(hypotheses: Array, truth: Array, *, where: Mask | None = None) -> Array:
    """Largest error of the mean pose at a joint that counts."""
    errors = np.linalg.norm(hypotheses.mean(axis=0) - truth, axis=-1)
    return np.where(where, errors, -np.inf).max(axis=1)


def joint_spread(hypotheses: Array, truth: Array) -> Array:
    return hypotheses.std(axis=0).mean(axis=-1)


def block(N: int = 5, B: int = 4, K: int = 3) -> tuple[Block, Array, Array, Mask]:
    """A block with its hypotheses and truth relative to joint 0, and a mask in which pose 1 lacks a joint."""
    x, y = skewed(3, N, B, K)
    where = np.ones((B, K), dtype=bool)
    where[1, 2] = False
    return Block(x, y, where, root=0), x - x[:, :, :1], y - y[:, :1], where


def test_a_function_becomes_a_metric_that_its_docstring_defines() -> None:
    metric = Metric.from_function(depth_error)
    assert (metric.name, metric.label) == ("depth_error", "depth error")
    assert metric.definition == metric.brief == "Mean absolute error along the third axis."
    assert (metric.unit, metric.direction, metric.family) == ("mm", "lower", "accuracy")
    assert metric.headline
    assert metric.in_group_table
    assert not metric.in_joint_table
    assert metric.by_joint is None


def test_what_a_function_does_not_say_is_given_beside_it() -> None:
    words = {"label": "L", "unit": "", "range": "0 to 1", "reading": "Read it.", "source": "Me, 2024."}
    metric = Metric.from_function(
        joint_spread,
        name="own",
        definition="mean σ",
        direction="none",
        family="sharpness",
        in_group_table=False,
        **words,
    )
    assert (metric.name, metric.definition, metric.direction, metric.family) == ("own", "mean σ", "none", "sharpness")
    assert {name: getattr(metric, name) for name in words} == words
    assert not metric.in_group_table
    assert Metric.from_function(joint_spread).definition == "mean over poses of joint_spread"


def test_a_function_gets_arrays_in_mm_relative_to_the_root() -> None:
    part, x, y, _ = block()
    values = Metric.from_function(depth_error).statistic.compute(part)
    np.testing.assert_allclose(values[[0, 2, 3]], depth_error(x, y)[[0, 2, 3]], rtol=1e-12)


def test_a_pose_that_lacks_a_joint_does_not_count_unless_the_function_takes_the_mask() -> None:
    part, x, y, where = block()
    assert np.isnan(Metric.from_function(depth_error).statistic.compute(part)).tolist() == [False, True, False, False]
    values = Metric.from_function(worst_joint).statistic.compute(part)
    np.testing.assert_allclose(values, worst_joint(x, y, where=where), rtol=1e-12)
    assert np.isfinite(values).all()


def test_a_function_may_give_a_value_per_joint() -> None:
    part, x, y, where = block()
    metric = Metric.from_function(joint_spread, by_joint=True)
    values = metric.statistic.compute(part)
    np.testing.assert_allclose(values, np.where(where, joint_spread(x, y), np.nan), rtol=1e-12)
    assert metric.in_joint_table
    assert metric.by_joint is not None
    np.testing.assert_array_equal(metric.by_joint[1](values), values)
    np.testing.assert_array_equal(metric.finish(values), mean_over_joints(values))


def test_posecal_s_own_functions_of_arrays_are_such_functions() -> None:
    part, x, y, where = block()
    values = Metric.from_function(posecal.metrics.pck, name="own").statistic.compute(part)
    np.testing.assert_allclose(values, posecal.metrics.pck(x, y, where=where, axes="NMKD"), rtol=1e-12)


@pytest.mark.parametrize(
    ("function", "options", "words"),
    [
        (
            lambda x, y: y[:, 0, 0],
            {},
            r"^metric: <function .*<lambda>.*>; expected a function with a name, or the name",
        ),
        (depth_error, {"name": "depth error"}, r"^metric: .*; expected a function with a name"),
        (depth_error, {"name": "2d"}, r"expected a function with a name"),
        (3, {}, r"^metric: 3; expected a function with a name"),
        (3, {"name": "three"}, r"^metric: 3; expected a function with a name"),
        (
            depth_error,
            {"direction": "down"},
            r"^metric: direction 'down'; expected one of lower, higher, zero, none\.$",
        ),
        (depth_error, {"direction": []}, r"^metric: direction \[\]; expected one of lower"),
        (depth_error, {"family": "scale"}, r"^metric: family 'scale'; expected one of accuracy, calibration, "),
        (depth_error, {"unit": None}, r"^metric: unit None; expected text\.$"),
        (depth_error, {"label": 3}, r"^metric: label 3; expected text\.$"),
        (depth_error, {"reading": None}, r"^metric: reading None; expected text\.$"),
    ],
)
def test_what_is_no_function_or_has_no_name_is_refused(function: Any, options: dict[str, Any], words: str) -> None:
    with pytest.raises(PoseDataError, match=words):
        Metric.from_function(function, **options)


@pytest.mark.parametrize(
    ("function", "by_joint", "words"),
    [
        (
            lambda x, y: y[:, :, 0],
            False,
            r"^metric: own gave \(4, 3\) for 4 poses; expected \(4,\), or by_joint=True\.$",
        ),
        (lambda x, y: y[:, 0, 0], True, r"^metric: own gave \(4,\) for 4 poses; expected \(4, 3\)\."),
        (lambda x, y: y[:, 0, 0] * 1j, False, r"^metric: own gave complex(64|128); expected real numbers\.$"),
        (lambda x, y: 1.0, False, r"^metric: own gave \(\) for 4 poses; expected \(4,\)\."),
        (
            lambda x, y: ["a"] * 4,
            False,
            r"^metric: own fails on hypotheses \(5, 4, 3, 3\) \(ValueError: could not conv",
        ),
        (
            lambda x, y: 1 / 0,
            False,
            r"^metric: own fails on hypotheses \(5, 4, 3, 3\) \(ZeroDivisionError: division by",
        ),
        (lambda x: x, False, r"^metric: own fails on .* \(TypeError: .*takes 1 positional argument"),
        (posecal.metrics.min_mpjpe, True, r"^metric: own gave \(4,\) for 4 poses; expected \(4, 3\)\."),
    ],
)
def test_a_function_that_fails_or_gives_another_shape_is_refused(function: Any, by_joint: bool, words: str) -> None:
    statistic = Metric.from_function(function, name="own", by_joint=by_joint).statistic
    with pytest.raises(PoseDataError, match=words):
        statistic.compute(block()[0])


def test_a_built_in_function_without_a_signature_takes_no_mask() -> None:
    with pytest.raises(PoseDataError, match=r"^metric: max fails on hypotheses .* \(ValueError: The truth value of"):
        Metric.from_function(max).statistic.compute(block()[0])


def test_a_deviation_is_over_curves_in_a_known_way() -> None:
    with pytest.raises(PoseDataError, match=r"^metric: over 'best'; expected one of median, mean, worst\.$"):
        Deviation(over="best")  # type: ignore[arg-type]


def test_what_a_function_refuses_itself_is_said_in_its_own_words() -> None:
    def picky(hypotheses: Array, truth: Array) -> Array:
        raise PoseDataError("truth: too good to be true.")

    with pytest.raises(PoseDataError, match=r"^truth: too good to be true\.$"):
        Metric.from_function(picky).statistic.compute(block()[0])


@pytest.mark.parametrize("by_joint", [False, True])
def test_a_mean_over_poses_is_restored_from_its_description_without_its_function(by_joint: bool) -> None:
    metric = Metric.from_function(joint_spread, by_joint=by_joint, unit="cm", reading="Read it.")
    restored = pickle.loads(pickle.dumps(metric))
    assert restored.description == metric.description
    assert (restored.unit, restored.reading, restored.in_joint_table) == ("cm", "Read it.", by_joint)
    assert [statistic.name for statistic in restored.statistics] == [statistic.name for statistic in metric.statistics]
    means = np.array([[1.0, 2, 6], [3, 3, 3]]) if by_joint else np.array([3.0, 3])
    np.testing.assert_array_equal(restored.finish(means), [3, 3])
    with pytest.raises(PoseDataError, match=r"^metric: the functions of joint_spread are not available here; expected"):
        restored.statistic.compute(block()[0])


def test_a_metric_with_a_finish_of_its_own_is_restored_without_it() -> None:
    words = {"name": "rms", "label": "RMS", "unit": "mm", "brief": "root mean square", "definition": "root mean square"}
    squares = Statistic("squares", lambda block: (block.offsets**2).mean(axis=(1, 2, 3)))
    metric = Metric(**words, direction="lower", family="accuracy", statistic=squares, finish=np.sqrt, headline=True)
    restored = pickle.loads(pickle.dumps(metric))
    assert restored.description == metric.description
    with pytest.raises(PoseDataError, match=r"^metric: the functions of rms are not available here; expected it to be"):
        restored.finish(np.array(4.0))
