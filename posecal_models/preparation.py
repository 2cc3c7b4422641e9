"""Setup of a training: data split by subject, the estimator, and the constants of its standardizer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from posecal.data.skeleton import joint_set
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.checkpoint import load_estimator
from posecal_models.config import Config
from posecal_models.contract import Context
from posecal_models.data.fresh_views import FreshViews
from posecal_models.data.lifting_set import LiftingSet
from posecal_models.data.mocap import MocapPoses
from posecal_models.data.npz import read_npz
from posecal_models.data.standardizer import check_pixels
from posecal_models.data.training_set import TrainingSet, seeded_generator
from posecal_models.distributed import ProcessGroup
from posecal_models.estimators.amortized_posterior import AmortizedPosterior
from posecal_models.estimators.gaussian_noise import GaussianNoise
from posecal_models.estimators.registry import ReferenceEstimator, baseline_keypoints, build_from_config, describe
from posecal_models.estimators.simple_baseline import HOURGLASS, SimpleBaseline
from posecal_models.settings import DataConfig, ModelConfig
from posecal_models.train import Training
from posecal_models.training_folder import CHECKPOINT, check_folder, digests

__all__ = ["prepare", "split"]

_FIT_POSES = 20_000


def split(path: str | Path, config: DataConfig) -> tuple[LiftingSet, LiftingSet | None, bool]:
    """Read poses and split them by subject into training and validation set.

    Parameters
    ----------
    path : str or Path
        Motion capture (:class:`posecal_models.data.mocap.MocapPoses`), projected into virtual cameras; or pairs of
        poses and keypoints (:class:`posecal_models.data.lifting_set.LiftingSet`).
    config : DataConfig
        Settings of the data, the held-out subjects among them.

    Returns
    -------
    training : LiftingSet
        All subjects but those for validation and test.
    validation : LiftingSet or None
        Evenly spaced poses of the validation subjects.
    exact : bool
        Whether keypoints are exact, so that a detector's noise is to be added.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read or lacks a subject.
    """
    held_out = (*config.test_subjects, *config.validation_subjects)
    exact = "poses" in read_npz(path)
    if exact:
        mocap = MocapPoses(path)
        training = mocap.project(
            views=config.views or 1,
            every=config.every,
            exclude=held_out,
            body_variation=config.body_variation,
            seed=config.camera_seed,
        )
        validation = None
        if config.validation_subjects:
            validation = mocap.project(
                views=config.views or 4,
                every=config.every,
                subjects=config.validation_subjects,
                seed=config.camera_seed,
            )
    else:
        if not config.views:
            raise PoseDataError(f"data.views: 0, but {path} has images already; expected motion capture, or 1 or more.")
        pairs = LiftingSet.load(path)
        known = set(pairs.subject.tolist())
        if missing := sorted(set(held_out) - known):
            raise PoseDataError(
                f"{path}: subjects {', '.join(missing)} not there; expected some of {', '.join(sorted(known))}."
            )
        training = pairs.take(~np.isin(pairs.subject, held_out))
        in_validation = np.isin(pairs.subject, config.validation_subjects)
        validation = pairs.take(in_validation) if config.validation_subjects else None
    if not len(training):
        raise PoseDataError(f"{path}: no pose is left for training. Hold out fewer subjects.")
    if validation is not None and len(validation) > config.validation_poses:
        validation = validation.take(np.linspace(0, len(validation) - 1, config.validation_poses).astype(int))
    return training, validation, exact


def prepare(
    config: Config,
    path: str | Path,
    folder: Path,
    *,
    device: torch.device | str = "cpu",
    resume: bool = False,
    processes: ProcessGroup | None = None,
) -> Training:
    """Set up a training.

    Parameters
    ----------
    config : Config
        The configuration.
    path : str or Path
        The poses, as :func:`split` reads them.
    folder : Path
        Output folder; created if its parent exists.
    device : torch.device or str
        Device of the training.
    resume : bool
        Resume from the folder's checkpoint if there is one.
    processes : ProcessGroup, optional
        The processes of a distributed training.

    Returns
    -------
    Training
        At its first step, or at that of the checkpoint.

    Raises
    ------
    PoseFileError, PoseDataError
        Where data and configuration don't fit, a process would have no pose of a batch, a file can't be written, or
        the folder holds a training already and ``resume`` is false.
    """
    processes = processes or ProcessGroup()
    processes.check_batch(config.train.batch)
    processes.check_cuda_graph(config.train.cuda_graph)
    check_folder(folder, resume=resume)
    mean = _mean(config.model)
    training, validation, exact = split(path, config.data)
    estimator = _estimator(config, mean, _keypoints(config.model, training))
    order = (estimator.joints, estimator.keypoints)
    for pairs in filter(None, (training, validation)):
        ordered = pairs.in_order_of(*order)
        estimator.check(Context(torch.from_numpy(ordered.keypoints), torch.from_numpy(ordered.observed)))
    detector = config.data.detector if exact else None
    data: TrainingSet | FreshViews
    if config.data.views:
        data = TrainingSet(training, *order, detector=detector, device=device)
    else:
        data = FreshViews.from_config(MocapPoses(path), config.data, *order, device=device)
    validation_data = None if validation is None else TrainingSet(validation, *order, detector=detector, device=device)
    rows = torch.linspace(0, len(data) - 1, min(len(data), _FIT_POSES), device=data.device).long()
    context, truth = data.batch(rows, seeded_generator(config.train.seed))
    context, truth = context.to("cpu"), truth.cpu()
    check_pixels(context)
    if not isinstance(estimator, GaussianNoise) and not config.model.start and config.model.units == "fitted":
        if isinstance(estimator, AmortizedPosterior):
            estimator.fit(truth, context)
        else:
            estimator.standardizer.fit(truth, context.keypoints, context.observed)
    try:
        folder.mkdir(exist_ok=True)
    except OSError as problem:
        raise PoseFileError(f"{folder}: can't be made ({problem.strerror}).") from problem
    run = Training(
        estimator.to(device),
        config,
        data,
        folder=folder,
        validation=validation_data,
        processes=processes,
        digests=digests(path),
    )
    if resume and (folder / CHECKPOINT).exists():
        run.resume()
    return run


def _keypoints(config: ModelConfig, training: LiftingSet) -> tuple[str, ...] | None:
    """Name the keypoints of an estimator that reads all of them: those that some image of the training set has.

    Models of other papers read as many as published: the neck's where the hip's is missing.
    """
    if config.kind in ("cgnf", "gaussian-noise"):
        return None
    names = baseline_keypoints(config)
    keypoints = training.in_order_of(keypoint_joints=names).keypoints
    if names == HOURGLASS:
        return HOURGLASS if np.isfinite(keypoints[:, 0]).any() else joint_set("h36m-16")
    available = tuple(name for j, name in enumerate(names) if np.isfinite(keypoints[:, j]).any())
    if not available:
        raise PoseDataError(f"keypoints: no image has any of {', '.join(names)}; expected some of them in each.")
    if config.origin == "root" and names[0] not in available:
        raise PoseDataError(
            f"keypoints: no image has the {names[0]}'s, and model.origin = root reads the others relative to it; "
            "expected it in every image. Give it, or leave model.origin at its default."
        )
    return available


def _mean(config: ModelConfig) -> SimpleBaseline | None:
    """Load the point estimator of a Gaussian noise model."""
    if config.kind != "gaussian-noise":
        return None
    if not config.mean:
        raise PoseDataError("model.mean: not given; expected the weights file of a trained SimpleBaseline.")
    mean = load_estimator(config.mean)
    if not isinstance(mean, SimpleBaseline):
        raise PoseDataError(f"model.mean: {config.mean} holds a {type(mean).__name__}; expected a SimpleBaseline.")
    return mean


def _estimator(config: Config, mean: SimpleBaseline | None, keypoints: tuple[str, ...] | None) -> ReferenceEstimator:
    """Build the estimator, or load the one that training starts from."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.train.seed)
        estimator = build_from_config(config.model, mean=mean, keypoints=keypoints)
    if not config.model.start:
        return estimator
    loaded = load_estimator(config.model.start)
    expected, actual = describe(estimator), describe(loaded)
    different = [name for name in expected if expected[name] != actual.get(name)]
    if isinstance(loaded, GaussianNoise) and mean is not None and not different:
        weights = mean.state_dict()
        if any(not torch.equal(tensor, weights[name]) for name, tensor in loaded.mean.state_dict().items()):
            different = ["the weights of the mean"]
    if different:
        raise PoseDataError(
            f"model.start: {config.model.start} differs from the configuration in {', '.join(different)}. "
            "Set [model] to the options of these weights."
        )
    return loaded
