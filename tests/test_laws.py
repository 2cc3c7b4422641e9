"""Laws that every registered number obeys, whatever it is.

A law changes a world in a way that must not change the numbers, or must change them in a known way. It holds for
every metric that the registry knows, so that a new one is tested on the day it is registered; the few that a law
does not bind are listed with the reason, and each of them must really break it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fnmatch import fnmatch
from functools import cache, partial

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from posecal.calibration.rank_tests import NEEDS_COORDINATE_RANGE
from posecal.engine import chunks
from posecal.engine.merge import merge_totals
from posecal.engine.protocol import Protocol
from posecal.engine.totals import Totals
from posecal.evaluation import evaluate
from posecal.registry import known_metrics
from posecal.report.comparison import compare_totals
from tests.helpers.law_exemptions import PROTOCOLS, UNBOUND, exempt
from tests.helpers.random_worlds import World, world

Numbers = dict[str, float]
Change = Callable[[World], World]

ROUNDING = 1e-7
"""Relative; rotations that nearly tie cost 1e-8 (:mod:`tests.test_align`), all else less."""

WORLD = world(1, N=6, M=30)
WORLDS = {name: replace(WORLD, root_joint="none" if name == "world" else None) for name in PROTOCOLS}


@cache
def usual(protocol: str) -> Numbers:
    return WORLDS[protocol].values(PROTOCOLS[protocol])


def numbers(totals: Totals) -> Numbers:
    return {name: totals.value(metric) for name, metric in known_metrics(totals.protocol, totals.spec).items()}


def hold(
    law: str, protocol: str, found: Numbers, expected: Numbers, rtol: float = ROUNDING, atol: float = 1e-9
) -> None:
    """Check that a law binds every number but those that are exempt."""
    assert set(found) == set(expected)
    for name, value in expected.items():
        if exempt(law, protocol, name) is None:
            np.testing.assert_allclose(found[name], value, rtol=rtol, atol=atol, err_msg=f"{law}: {name}")


# --- changes that change nothing -------------------------------------------------------------------------------------

TURN = Rotation.from_euler("xyz", [0.4, -1.1, 2.3]).as_matrix()
QUARTER = np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])


def frames_shuffled(some: World) -> World:
    """Sequences in another order, and their frames; each sequence stays together, as WA-MPJPE asks."""
    random = np.random.default_rng(0)
    names = random.permutation(np.unique(some.sequence))
    return some.select(np.concatenate([random.permutation(np.flatnonzero(some.sequence == name)) for name in names]))


def sequences_reversed(some: World) -> World:
    names = list(dict.fromkeys(some.sequence.tolist()))[::-1]
    return some.select(np.concatenate([np.flatnonzero(some.sequence == name) for name in names]))


def hypotheses_shuffled(some: World) -> World:
    order = np.roll(np.arange(len(some.x)), 2)[::-1]
    return replace(some, x=some.x[order], scores=some.scores[order])


def joints_shuffled(some: World) -> World:
    order = np.random.default_rng(2).permutation(len(some.joints))
    return replace(
        some,
        x=some.x[:, :, order],
        y=some.y[:, order],
        joints=tuple(some.joints[k] for k in order),
        occluded=some.occluded[:, order],
        where=None if some.where is None else some.where[:, order],
    )


def moved(some: World) -> World:
    """Every pose elsewhere, its hypotheses with it."""
    steps = np.random.default_rng(3).normal(0, 900, (len(some.y), 1, 3))
    return replace(some, x=some.x + steps, y=some.y + steps)


def turned(by: npt.NDArray[np.float64]) -> Change:
    return lambda some: replace(some, x=some.x @ by.T, y=some.y @ by.T)


def renamed(some: World) -> World:
    return replace(some, sequence=np.char.add("clip ", some.sequence), action=np.char.upper(some.action))


def masked_nowhere(some: World) -> World:
    return replace(some, where=np.ones(some.y.shape[:2], dtype=bool))


def scaled(some: World) -> World:
    return replace(some, x=1.7 * some.x, y=1.7 * some.y)


def twice(some: World) -> World:
    return replace(some, x=np.tile(some.x, (2, 1, 1, 1)), scores=np.tile(some.scores, (2, 1)))


STAYING: dict[str, Change] = {
    "order of frames": frames_shuffled,
    "order of sequences": sequences_reversed,
    "order of hypotheses": hypotheses_shuffled,
    "order of joints": joints_shuffled,
    "translation": moved,
    "rotation": turned(TURN),
    "quarter turn": turned(QUARTER),
    "names of labels": renamed,
    "a mask of nothing": masked_nowhere,
}
CHANGES = STAYING | {"scale": scaled, "twice": twice}


@cache
def after(law: str, protocol: str) -> Numbers:
    return CHANGES[law](WORLDS[protocol]).values(PROTOCOLS[protocol])


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("law", STAYING)
def test_numbers_stay(law: str, protocol: str) -> None:
    hold(law, protocol, after(law, protocol), usual(protocol))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_only_scaling_about_the_origin_sees_where_poses_without_a_root_are(protocol: str) -> None:
    rootless = replace(WORLD, root_joint="none")
    expected = rootless.values(PROTOCOLS[protocol])
    hold("origin", protocol, moved(rootless).values(PROTOCOLS[protocol]), expected)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_lengths_scale_and_shares_stay(protocol: str) -> None:
    metrics = known_metrics(PROTOCOLS[protocol], WORLDS[protocol].spec)
    expected = {
        name: value * (1.7 if metrics[name].unit.startswith("mm") else 1) for name, value in usual(protocol).items()
    }
    hold("scale", protocol, after("scale", protocol), expected)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_pck_scales_with_its_threshold(protocol: str) -> None:
    p, factor = PROTOCOLS[protocol], 0.3
    small = replace(WORLDS[protocol], x=factor * WORLD.x, y=factor * WORLD.y)
    found = small.values(replace(p, pck_threshold=factor * p.pck_threshold))["pck"]
    np.testing.assert_allclose(found, usual(protocol)["pck"])


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_hypotheses_that_stand_there_twice_change_only_what_depends_on_their_number(protocol: str) -> None:
    found = {name: value for name, value in after("twice", protocol).items() if name in usual(protocol)}
    hold("twice", protocol, found, usual(protocol))


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_sequence_of_which_no_joint_counts_is_as_if_it_were_not_there(protocol: str) -> None:
    gone = WORLD.sequence == "S11/a"
    masked = replace(WORLDS[protocol], where=np.tile(~gone[:, None], (1, len(WORLD.joints))))
    expected = WORLDS[protocol].select(np.flatnonzero(~gone)).values(PROTOCOLS[protocol])
    hold("without a sequence", protocol, masked.values(PROTOCOLS[protocol]), expected)


@pytest.mark.parametrize("average", ["poses", "action"])
def test_a_sequence_of_which_no_joint_counts_makes_no_interval_narrower(average: str) -> None:
    r = np.random.default_rng(8)
    truth = 200 * r.normal(size=(120, 17, 3))
    sequence, shift = np.arange(120) // 10, 40 * r.normal(size=(12, 1, 1))[np.arange(120) // 10]
    models = [truth + shift + spread * r.normal(size=(6, 120, 17, 3)) for spread in (50, 70)]
    labels = {"sequence": sequence, "action": sequence % 3}
    gone = (sequence % 4 == 1) | (sequence == 8)
    protocol = Protocol(metrics=("default", "scores"), average=average)
    report = partial(evaluate, protocol=protocol, joints="h36m-17")
    where = np.tile(~gone[:, None], (1, 17))
    masked = [report(x, truth, where=where, labels=labels) for x in models]
    kept = {name: values[~gone] for name, values in labels.items()}
    alone = [report(x[:, ~gone], truth[~gone], labels=kept) for x in models]
    with_interval = [name for name in alone[0].metrics if not np.isnan(alone[0].interval(name)).any()]
    assert {"mpjpe", "spread_error_correlation", "radius_90", "auc"} <= set(with_interval)
    for name in with_interval:
        np.testing.assert_allclose(masked[0].interval(name), alone[0].interval(name), rtol=1e-6, err_msg=name)
    found, expected = (compare_totals([each.totals for each in some], ["a", "b"]) for some in (masked, alone))
    for name in ("mpjpe", "ece", "spread_error_correlation", "radius_90"):
        (one,), (other,) = found.differences_of(name), expected.differences_of(name)
        np.testing.assert_allclose(
            [one.low, one.high, one.p], [other.low, other.high, other.p], rtol=1e-6, err_msg=name
        )


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_joints_that_do_not_count_may_hold_anything(protocol: str) -> None:
    where = np.random.default_rng(4).random(WORLD.y.shape[:2]) < 0.8
    where[:, WORLD.joints.index("Hip")] = True
    x, y = WORLD.x.copy(), WORLD.y.copy()
    x[:, ~where], y[~where] = np.nan, np.inf
    masked = replace(WORLDS[protocol], where=where)
    found = replace(masked, x=x, y=y).values(PROTOCOLS[protocol])
    hold("masked", protocol, found, masked.values(PROTOCOLS[protocol]), rtol=0, atol=0)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_of_one_hypothesis_every_choice_among_hypotheses_is_the_same(protocol: str) -> None:
    p = replace(PROTOCOLS[protocol], mode="0")
    found = replace(WORLDS[protocol], x=WORLD.x[:1], scores=WORLD.scores[:1]).values(p)
    for prefix in ("", "pa_", "n_"):
        for name in ("min", "median", "worst", "mean_pose", "median_pose", "weighted_pose", "mode"):
            np.testing.assert_allclose(found[f"{prefix}{name}_mpjpe"], found[f"{prefix}mpjpe"], rtol=ROUNDING)
    np.testing.assert_allclose(found["min_mpjpe_at_1"], found["mpjpe"])
    for name in ("mpjve", "acceleration_error", "jitter"):
        np.testing.assert_allclose(found[f"mean_pose_{name}"], found[name])
    assert not np.isnan(list(found.values())).any()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_a_perfect_hypothesis_among_others_is_the_best(protocol: str) -> None:
    found = replace(WORLDS[protocol], x=np.concatenate([WORLD.y[None], WORLD.x[1:]])).values(PROTOCOLS[protocol])
    for name in ("min_mpjpe", "pa_min_mpjpe", "n_min_mpjpe"):
        np.testing.assert_allclose(found[name], 0, atol=1e-6)
    if PROTOCOLS[protocol].pck_best != "mean":
        np.testing.assert_allclose(found["pck"], 1)


# --- the same, computed in another way -------------------------------------------------------------------------------


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_numbers_do_not_depend_on_the_threads_to_the_last_bit(protocol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", 8000)
    alone = WORLDS[protocol].totals(PROTOCOLS[protocol])
    together = WORLDS[protocol].totals(PROTOCOLS[protocol], threads=3)
    assert list(together.sums) == list(alone.sums)
    for name, sums in alone.sums.items():
        assert together.sums[name].tobytes() == sums.tobytes(), name


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(("block", "window"), [(1, None), (6000, 14000)])
def test_numbers_do_not_depend_on_how_poses_are_cut_into_blocks(
    protocol: str, block: int | None, window: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    expected = usual(protocol)
    if block is not None:
        monkeypatch.setattr("posecal.engine.block.BLOCK_BYTES", block)
    if window is not None:
        monkeypatch.setattr(chunks, "WINDOW_BYTES", window)
    hold("blocks", protocol, WORLDS[protocol].values(PROTOCOLS[protocol]), expected, rtol=1e-12, atol=1e-12)


def shards(some: World, cuts: list[int]) -> Iterator[World]:
    """Some sequences each."""
    names = list(dict.fromkeys(some.sequence.tolist()))
    for part in np.split(np.array(names), cuts):
        yield some.select(np.flatnonzero(np.isin(some.sequence, part)))


def in_shards(protocol: str, cuts: list[int]) -> Numbers:
    return numbers(merge_totals([part.totals(PROTOCOLS[protocol]) for part in shards(WORLDS[protocol], cuts)]))


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("cuts", [[2], [1, 3]])
def test_shards_add_up_to_the_whole(protocol: str, cuts: list[int]) -> None:
    expected = {name: value for name, value in usual(protocol).items() if name not in NEEDS_COORDINATE_RANGE}
    hold("shards", protocol, in_shards(protocol, cuts), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_single_precision_stays_near_double(protocol: str) -> None:
    single = replace(WORLDS[protocol], x=WORLD.x.astype("f4"), y=WORLD.y.astype("f4")).values(PROTOCOLS[protocol])
    # Coordinates reach some 1,200 mm and a dozen roundings of 2**-24 each make 1e-3 mm a frame. No error is that near
    # to a threshold here, so that shares stay as they are but for the rounding of their own sums.
    metrics, rates = known_metrics(PROTOCOLS[protocol], WORLDS[protocol].spec), {"mm/s": 1, "mm/s²": 2, "mm/s³": 3}
    frame = {name: WORLD.fps ** -rates.get(metric.unit, 0) for name, metric in metrics.items()}
    found, expected = ({name: value * frame[name] for name, value in of.items()} for of in (single, usual(protocol)))
    hold("single precision", protocol, found, expected, rtol=1e-6, atol=12 * 1200 * 2**-24)


def layouts(array: npt.NDArray[np.floating]) -> dict[str, npt.NDArray[np.floating]]:
    """The same numbers, in memory in other ways."""
    return {
        "Fortran order": np.asfortranarray(array),
        "negative strides": array[..., ::-1, ::-1].copy()[..., ::-1, ::-1],
        "every other": np.repeat(array, 2, axis=-2)[..., ::2, :],
        "hypotheses or poses last": np.moveaxis(np.moveaxis(array, 0, -1).copy(), -1, 0),
    }


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize("layout", layouts(WORLD.y))
def test_numbers_do_not_depend_on_the_layout_in_memory(layout: str, protocol: str) -> None:
    other = replace(WORLDS[protocol], x=layouts(WORLD.x)[layout], y=layouts(WORLD.y)[layout])
    hold("layout", protocol, other.values(PROTOCOLS[protocol]), usual(protocol), rtol=0, atol=0)


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_arrays_stay_as_they_were(protocol: str) -> None:
    arrays = (WORLD.x, WORLD.y, WORLD.scores, WORLD.occluded)
    before = [array.tobytes() for array in arrays]
    for array in arrays:
        array.flags.writeable = False
    try:
        WORLDS[protocol].values(PROTOCOLS[protocol])
    finally:
        for array in arrays:
            array.flags.writeable = True
    assert [array.tobytes() for array in arrays] == before


@pytest.mark.slow
@given(
    protocol=st.sampled_from(list(PROTOCOLS)),
    N=st.integers(3, 6),
    M=st.integers(10, 17),
    seed=st.integers(0, 10**6),
    share=st.sampled_from([0.5, 0.8, 1.0]),
    length=st.integers(1, 9),
    cut=st.integers(1, 4),
    threads=st.integers(1, 2),
)
def test_any_world_masked_cut_and_split_anyhow_gives_the_same(
    protocol: str, N: int, M: int, seed: int, share: float, length: int, cut: int, threads: int
) -> None:
    some = replace(world(seed, N, M), root_joint=WORLDS[protocol].root_joint)
    where = np.random.default_rng(seed).random(some.y.shape[:2]) < share
    where[:, some.joints.index("Hip")] = True
    where[np.arange(M), 5] = True  # no shard is empty
    some = replace(some, where=where, occluded=some.occluded | (np.arange(8) == 5))
    if PROTOCOLS[protocol].where == "visible":
        some = replace(some, occluded=~some.occluded)
    expected = some.values(PROTOCOLS[protocol])
    expected = {name: value for name, value in expected.items() if name not in NEEDS_COORDINATE_RANGE}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("posecal.engine.block.BLOCK_BYTES", length * N * 8 * 3 * 8)
        parts = [part.totals(PROTOCOLS[protocol], threads=threads) for part in shards(some, [cut])]
    hold("shards", protocol, numbers(merge_totals(parts)), expected, rtol=1e-12, atol=1e-12)


# --- the list of exemptions ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("law", "pattern"),
    [(law, pattern) for law in CHANGES if law in UNBOUND for pattern in UNBOUND[law]],
)
def test_what_a_law_does_not_bind_really_breaks_it(law: str, pattern: tuple[str, str]) -> None:
    protocols = [name for name in PROTOCOLS if fnmatch(name, pattern[1])]
    changed = {
        name
        for protocol in protocols
        for name, value in after(law, protocol).items()
        if name in usual(protocol) and not np.isclose(value, usual(protocol)[name], rtol=0, atol=1e-6, equal_nan=True)
    }
    assert [name for name in changed if fnmatch(name, pattern[0])]
