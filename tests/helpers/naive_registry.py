"""Every registered metric once more, by the naive formulas: what each number must be under a protocol."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import numpy.typing as npt

from posecal.data.skeleton import JOINT_SETS, Skeleton
from posecal.engine.protocol import Protocol
from tests.helpers import calibration_oracles, oracles, score_oracles
from tests.helpers.random_worlds import JOINTS, World

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
Poses = npt.NDArray[np.intp]
Numbers = dict[str, Callable[[Poses], float]]


def mean_known(values: Array) -> float:
    """Mean of what is not NaN."""
    return oracles.mean([float(v) for v in values if not math.isnan(v)])


class Twin:
    """Every number of a world under a protocol, by the naive formulas."""

    def __init__(self, some: World, protocol: Protocol) -> None:
        self.world, self.protocol = some, protocol
        self.x, self.y = oracles.relative(some.x, some.root), oracles.relative(some.y, some.root)
        usable = np.ones(some.y.shape[:2], dtype=bool) if some.where is None else some.where
        self.counted, self.fitted = usable, usable & self.joints(protocol.joints)
        if protocol.where == "occluded":
            self.counted = self.counted & some.occluded
        if protocol.where == "visible":
            self.counted = self.counted & ~some.occluded
        if some.root is not None:  # a pose of which only the root is scored is left out
            scored = self.counted & self.joints(protocol.joints)
            alone = scored.any(axis=1) & ~np.delete(scored, some.root, axis=1).any(axis=1)
            self.counted = self.counted & ~alone[:, None]
        body = self.joints(protocol.joints)
        if protocol.root == "drop" and some.root is not None:
            body[some.root] = False
        moving = body.copy()
        if some.root is not None:
            moving[some.root] = False
        self.body, self.moving, self.moving_joints = self.counted & body, self.counted & moving, moving
        self.pck_joints = self.body & self.joints(protocol.pck_joints)
        self.cps_joints = self.body & self.joints(protocol.cps_joints)
        self.errors = oracles.pose_errors(self.x, self.y, self.body)
        self.links = oracles.links(self.errors)
        self.numbers: Numbers = {}
        self.by_joint: dict[str, Callable[[Poses], Array]] = {}
        self.of_curves: set[str] = set()
        self.define()

    def joints(self, text: str) -> Mask:
        if text.startswith("all but "):
            return np.array([name != text.removeprefix("all but ") for name in JOINTS])
        names = JOINTS if text == "all" else JOINT_SETS.get(text, tuple(text.split(", ")))
        return np.array([name in names for name in JOINTS])

    def value(self, name: str) -> float:
        """The number over all poses, or the mean over the groups that the protocol averages."""
        label = self.protocol.average
        if label == "poses" or name in self.of_curves:
            return self.numbers[name](np.arange(len(self.y)))
        groups = getattr(self.world, label)
        return mean_known(np.array([self.numbers[name](np.flatnonzero(groups == g)) for g in np.unique(groups)]))

    def joint_values(self, name: str) -> Array:
        """The same for each joint."""
        label, of = self.protocol.average, self.by_joint[name]
        if label == "poses" or name in self.of_curves:
            return of(np.arange(len(self.y)))
        groups = getattr(self.world, label)
        values = np.array([of(np.flatnonzero(groups == g)) for g in np.unique(groups)])
        return np.array([mean_known(column) for column in values.T])

    def groups(self, poses: Poses) -> list[Poses]:
        """The poses of each group that the protocol averages."""
        if self.protocol.average == "poses":
            return [poses]
        label = getattr(self.world, self.protocol.average)[poses]
        return [poses[label == g] for g in np.unique(label)]

    def curves(self, weights: Array, poses: Poses) -> Array:
        """ω_k(q), (K, 21): the mean of those of the groups in which joint k counts."""
        return calibration_oracles.curves(
            np.array([calibration_oracles.curves(weights[group]) for group in self.groups(poses)])
        )

    def pooled(self, weights: Array, poses: Poses) -> Array:
        """The mean of the groups' pooled curves."""
        found = [calibration_oracles.pooled_curve(weights[group]) for group in self.groups(poses)]
        return calibration_oracles.curves(np.array(found)[:, None])[0]

    def over_poses(self, name: str, values: Array, factor: float = 1.0) -> None:
        self.numbers[name] = lambda poses: factor * mean_known(values[poses])

    def define(self) -> None:
        p = self.protocol
        for prefix, align in (("", "none"), ("pa_", p.align), ("n_", p.scale)):
            self.define_errors(prefix, align)
        for n in (1, 2, 5):
            subsets = [oracles.best_of_subsets(list(e), n) for e in self.errors.T]
            self.over_poses(f"min_mpjpe_at_{n}", np.array(subsets))
        self.define_shares()
        factor = self.world.fps if p.velocity == "second" else 1.0
        for prefix, x in (("", self.x), ("mean_pose_", oracles.one_pose(self.x, "mean_pose"))):
            for order, name in ((1, "mpjve"), (2, "acceleration_error"), (3, "jitter")):
                moving = x if name == "jitter" else x - self.y
                changes = oracles.motion(moving, self.body, list(self.world.sequence), order)
                self.over_poses(prefix + name, changes, factor**order)
        self.over_poses("true_jitter", oracles.motion(self.y[None], self.body, list(self.world.sequence), 3), factor**3)
        if self.world.root is None:
            self.define_world()
        before = set(self.numbers)
        self.define_calibration()
        self.define_rank_tests()
        self.of_curves = set(self.numbers) - before
        less = 0 if p.deviation == "population" else 1
        self.define_spread("diversity", oracles.deviations(self.x, less))
        for share in (50, 90):
            self.define_spread(f"radius_{share}", oracles.radii(self.x, share / 100))
        for percent in (50, 90):
            width = calibration_oracles.over_axes(
                self.x, self.y, lambda x, _, c=percent: float(np.ptp(calibration_oracles.interval(x, c)))
            )
            self.define_spread(f"interval_width_{percent}", width)
        self.define_scores()
        self.define_uncertainty()

    def define_errors(self, prefix: str, align: str) -> None:
        p, names = self.protocol, self.world.sequence
        x = oracles.aligned(self.x, self.y, self.fitted, align)
        e = oracles.pose_errors(x, self.y, self.body)
        kind, _, clips = p.best.partition(":")
        if kind == "joint":
            self.over_poses(f"{prefix}min_mpjpe", oracles.best_per_joint(x, self.y, self.body))
        elif kind != "frame":
            self.numbers[f"{prefix}min_mpjpe"] = lambda poses: oracles.best_per_batch(
                e[:, poses], list(names[poses]), int(clips or 1)
            )
        elif prefix == "pa_" and p.align_best == "linked":
            self.over_poses("pa_min_mpjpe", np.array([e[n, m] for m, n in enumerate(self.links)]))
        else:
            self.numbers[f"{prefix}min_mpjpe"] = lambda poses: oracles.best_per_frame(e[:, poses])
        for of, name in (("mean", "mpjpe"), ("median", "median_mpjpe"), ("worst", "worst_mpjpe")):
            self.over_poses(prefix + name, np.array([oracles.of_errors(list(column), of) for column in e.T]))
        index = None if p.mode == "score" else int(p.mode)
        for of in ("mean_pose", "median_pose", "weighted_pose", "mode"):
            pose = oracles.one_pose(self.x, of, self.world.scores, index if of == "mode" else None)
            moved = oracles.aligned(pose, self.y, self.fitted, align)
            self.over_poses(f"{prefix}{of}_mpjpe", oracles.pose_errors(moved, self.y, self.body)[0])
        if not prefix:
            d = oracles.joint_errors(x, self.y)
            chosen = np.array([d[n, m] for m, n in enumerate(self.links)])
            self.over_joints("mpjpe", d.mean(axis=0), self.body)
            if kind in {"frame", "joint"}:
                self.over_joints("min_mpjpe", chosen if kind == "frame" else d.min(axis=0), self.body)

    def define_shares(self) -> None:
        p = self.protocol
        d, strict = oracles.joint_errors(self.x, self.y), p.pck_rule == "<"
        self.over_poses("pck", oracles.pck(d, self.pck_joints, p.pck_threshold, p.pck_best, self.links, strict=strict))
        if p.auc == "integral":
            self.over_poses("auc", oracles.auc_integral(d, self.pck_joints, p.pck_best, self.links))
        else:
            self.over_poses("auc", oracles.auc(d, self.pck_joints, p.pck_best, self.links, strict=strict))
        moved = oracles.joint_errors(oracles.aligned(self.x, self.y, self.fitted, p.align), self.y)
        how = (self.pck_joints, p.pck_threshold, p.pck_best, self.links)
        self.over_poses("pa_pck", oracles.pck(moved, *how, strict=strict))
        if p.auc == "integral":
            self.over_poses("pa_auc", oracles.auc_integral(moved, self.pck_joints, p.pck_best, self.links))
        else:
            self.over_poses("pa_auc", oracles.auc(moved, self.pck_joints, p.pck_best, self.links, strict=strict))
        self.define_limbs_and_root()
        d = oracles.joint_errors(oracles.aligned(self.x, self.y, self.fitted, p.cps_align), self.y)
        area = oracles.cps(d, self.cps_joints, p.cps_best, self.links)
        self.over_poses("cps", area, 1 / 300 if p.cps_unit == "share" else 1.0)

    def define_limbs_and_root(self) -> None:
        body = self.joints(self.protocol.joints)
        bones = [(p, c) for p, c in Skeleton(self.world.joints).bones if body[p] and body[c]]
        errors, spreads = np.full((2, len(self.y)), np.nan)
        for m, y in enumerate(self.y):
            known = [(p, c) for p, c in bones if self.counted[m, p] and self.counted[m, c]]
            if known:
                lengths = np.array([[np.linalg.norm(x[c] - x[p]) for x in self.x[:, m]] for p, c in known])
                true = np.array([np.linalg.norm(y[c] - y[p]) for p, c in known])
                errors[m], spreads[m] = np.abs(lengths - true[:, None]).mean(), lengths.std(axis=1).mean()
        if bones:
            self.over_poses("limb_length_error", errors)
            self.over_poses("limb_length_deviation", spreads)
        if (root := self.world.root) is not None:
            distances = np.linalg.norm(self.world.x[:, :, root] - self.world.y[:, root], axis=-1)
            distances[:, ~self.counted.any(axis=1)] = np.nan
            self.over_poses("min_root_error", distances.min(axis=0))
            self.over_poses("root_error", distances.mean(axis=0))

    def define_world(self) -> None:
        names, length = list(self.world.sequence), self.protocol.segment
        parts = oracles.segments(names, len(names) if length == "sequence" else int(length))
        for name, align in (("wa_mpjpe", "whole"), ("w_mpjpe", "first_two")):
            e = oracles.world_errors(self.x, self.y, self.body, self.fitted, parts, align)
            self.over_poses(name, e.mean(axis=0))
            self.numbers[f"min_{name}"] = lambda poses, e=e: oracles.best_per_batch(
                e[:, poses], [names[m] for m in poses], 1
            )

    def define_calibration(self) -> None:
        over = self.protocol.ece_over
        if over == "auto":
            over = "median" if self.protocol.where == "all" else "pooled"
        for definition, suffix in (("exchangeable", ""), ("paper", "_paper"), ("reference", "_reference")):
            weights = calibration_oracles.inside(self.x, self.y, self.moving, definition)
            for ending, how in (("", over), ("_mean", "mean"), ("_worst", "worst")):
                self.numbers[f"ece{suffix}{ending}"] = lambda poses, weights=weights, how=how: calibration_oracles.ece(
                    self.curves(weights, poses), self.pooled(weights, poses), how
                )
            self.by_joint[f"ece{suffix}"] = lambda poses, weights=weights: np.array(
                [calibration_oracles.curve_ece(curve) for curve in self.curves(weights, poses)]
            )
            if definition == "exchangeable":
                self.define_exchangeable(weights, over)

    def define_exchangeable(self, weights: Array, over: str) -> None:
        def summary(poses: Poses) -> Array:
            return calibration_oracles.over_joints(self.curves(weights, poses), self.pooled(weights, poses), over)

        def areas(poses: Poses) -> list[float]:
            found = [calibration_oracles.curve_area(curve) for curve in self.curves(weights, poses)]
            return [area for area in found if not math.isnan(area)] or [math.nan]

        self.numbers["signed_area"] = lambda poses: calibration_oracles.curve_area(summary(poses))
        self.numbers["signed_area_min"] = lambda poses: min(areas(poses))
        self.numbers["signed_area_max"] = lambda poses: max(areas(poses))
        self.by_joint["signed_area"] = lambda poses: np.array(
            [calibration_oracles.curve_area(curve) for curve in self.curves(weights, poses)]
        )
        for percent, level in ((50, 10), (80, 16), (90, 18), (95, 19)):
            known = 1.0 if self.has_ball(percent) else math.nan
            self.numbers[f"coverage_{percent}"] = lambda poses, at=level, known=known: known * summary(poses)[at]
            self.by_joint[f"coverage_{percent}"] = lambda poses, at=level, known=known: (
                known * self.curves(weights, poses)[:, at]
            )

        for percent in (50, 90):
            held = calibration_oracles.over_axes(
                self.x, self.y, lambda x, y, c=percent: calibration_oracles.held(x, y, c)
            )
            held = np.where(self.moving, held, math.nan)[..., None] * np.ones(21)
            name = f"interval_coverage_{percent}"
            self.by_joint[name] = lambda poses, held=held: self.curves(held, poses)[:, 0]
            self.numbers[name] = lambda poses, name=name: mean_known(self.by_joint[name](poses))

    def has_ball(self, percent: int) -> bool:
        """Whether so few hypotheses have a ball that holds a share of them."""
        return percent * (len(self.x) + 1) <= 100 * len(self.x)

    def define_spread(self, name: str, values: Array) -> None:
        self.over_joints(name, values, self.moving)
        self.numbers[name] = lambda poses: mean_known(self.by_joint[name](poses))

    def over_joints(self, name: str, values: Array, counted: Mask) -> None:
        def means(poses: Poses) -> Array:
            columns = zip(values[poses].T, counted[poses].T, strict=True)
            return np.array([oracles.mean(list(column[kept])) for column, kept in columns])

        self.by_joint[name] = means

    def counted_poses(self) -> list[tuple[int, Array, Array]]:
        """Each pose that moves, as the joints of it that count: (m, x (N, J, D), y (J, D))."""
        moving = [(m, self.moving[m]) for m in range(len(self.y)) if self.moving[m].any()]
        return [(m, self.x[:, m, w], self.y[m, w]) for m, w in moving]

    def define_scores(self) -> None:
        M, N, threshold = len(self.y), len(self.x), self.protocol.pck_threshold
        energies, variograms, briers = (np.full(M, math.nan) for _ in range(3))
        outcomes: dict[int, tuple[int, bool]] = {}
        for m, x, y in self.counted_poses():
            energies[m], variograms[m] = score_oracles.energy(x, y), score_oracles.variogram(x, y)
            outcomes[m] = score_oracles.near_median(x, y, threshold)
            briers[m] = score_oracles.brier(*outcomes[m], N)
        self.over_poses("energy_score", energies)
        self.over_poses("variogram_score", variograms)
        self.over_poses("brier", briers)
        for place, name in enumerate(("brier_miscalibration", "brier_discrimination")):
            self.numbers[name] = lambda poses, place=place: score_oracles.brier_parts(
                [outcomes[m] for m in poses if m in outcomes], N
            )[place]
        by_joint = {"energy": score_oracles.energy, "crps": score_oracles.crps}
        for name, score in by_joint.items():
            values = np.array([[score(self.x[:, m, k], self.y[m, k]) for k in range(len(JOINTS))] for m in range(M)])
            self.define_spread({"energy": "joint_energy_score"}.get(name, name), values)
        self.by_joint["energy_score"] = self.by_joint.pop("joint_energy_score")
        self.numbers["joint_energy_score"] = lambda poses: mean_known(self.by_joint["energy_score"](poses))

    def define_rank_tests(self) -> None:
        M, (_, K, D) = len(self.y), self.y.shape
        ranks = {name: np.full((M, 21), math.nan) for name in [*score_oracles.PRERANKS, "tarp_box"]}
        joints = self.moving_joints
        for m, x, y in self.counted_poses():
            pool = np.concatenate([x, y[None]])
            for name, prerank in score_oracles.PRERANKS.items():
                ranks[name][m] = score_oracles.rank_inside(prerank(pool))
            share = score_oracles.box_share(np.where(self.moving[m][:, None], self.y[m], math.nan)[joints])
            share = share[self.moving[m][joints]]
            apart = self.world.sequence != self.world.sequence[m]
            others = score_oracles.sides(self.y[apart], self.moving[apart])
            box = [ends for ends, there in zip(others, self.moving[m], strict=True) if there]
            ranks["tarp_box"][m] = score_oracles.rank_inside(score_oracles.tarp_box(pool, box, share))
        for name, weights in ranks.items():
            self.numbers[name] = lambda poses, weights=weights: calibration_oracles.curve_ece(
                self.pooled(weights[:, None], poses)
            )
        single = np.full((M, K, D, 21), math.nan)
        for m, k, d in np.ndindex(M, K, D):
            if self.moving[m, k]:
                single[m, k, d] = score_oracles.rank_inside([*self.x[:, m, k, d], self.y[m, k, d]])

        def by_joint(poses: Poses) -> Array:
            axes = [self.curves(single[:, :, d], poses) for d in range(D)]
            return np.array([oracles.mean([calibration_oracles.curve_ece(axis[k]) for axis in axes]) for k in range(K)])

        self.by_joint["coordinate_pit"] = by_joint
        self.numbers["coordinate_pit"] = lambda poses: mean_known(by_joint(poses))

    def define_uncertainty(self) -> None:
        deviations = oracles.deviations(self.x, 1)
        spread = np.array([oracles.mean(list(row[w])) for row, w in zip(deviations, self.moving, strict=True)])
        pose = oracles.one_pose(self.x, self.protocol.single_pose, self.world.scores)
        error = oracles.pose_errors(pose, self.y, self.body)[0]
        threshold = self.protocol.failure_threshold
        for name, of in (
            ("aurc", score_oracles.aurc),
            ("excess_aurc", score_oracles.excess_aurc),
            ("failure_auroc", partial(score_oracles.failure_auroc, threshold=threshold)),
            ("failure_rate", partial(score_oracles.failure_rate, threshold=threshold)),
            ("spread_error_correlation", score_oracles.rank_correlation),
            ("ause", score_oracles.ause),
        ):
            self.numbers[name] = lambda poses, of=of: of(
                *(list(values[poses][~np.isnan(spread[poses] + error[poses])]) for values in (spread, error))
            )

    def by_occlusion(self, occlusion: str) -> dict[str, float]:
        """The numbers over the occluded or over the visible joints: per pose their mean, then over poses."""
        mask = self.moving & (self.world.occluded if occlusion == "occluded" else ~self.world.occluded)
        e = oracles.pose_errors(self.x, self.y, mask)
        curve = calibration_oracles.pooled_curve(calibration_oracles.inside(self.x, self.y, mask, "exchangeable"))
        radii = oracles.radii(self.x, 0.5)
        return {
            "min_mpjpe": oracles.best_per_frame(e),
            "mpjpe": mean_known(e.mean(axis=0)),
            "ece": calibration_oracles.curve_ece(curve),
            "signed_area": calibration_oracles.curve_area(curve),
            "coverage_90": float(curve[18]) if self.has_ball(90) else math.nan,
            "radius_50": mean_known(np.array([oracles.mean(list(row[w])) for row, w in zip(radii, mask, strict=True)])),
        }
