"""What does a training leave in its folder, and does what is there already fit? Checkpoint, weights and loss curve."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from posecal.data.write import check_writable, write_file
from posecal.errors import PoseDataError, PoseFileError
from posecal_models.config import Config
from posecal_models.data.npz import read_npz

__all__ = ["CHECKPOINT", "LOSSES", "WEIGHTS", "check_folder", "check_same", "digests", "write_losses"]

CHECKPOINT, WEIGHTS, LOSSES = "checkpoint.safetensors", "weights.safetensors", "losses.csv"

_READ = {
    *("joints", "keypoint_joints", "axes", "unit", "up", "subject", "clip_id", "root_relative"),
    *("poses", "truth", "gt", "occluded", "keypoints_2d", "keypoints_observed", "keypoints_sigma"),
}


def check_folder(folder: Path, *, resume: bool) -> None:
    """Check, before any work, that a training can write its files and overwrites nobody's.

    Parameters
    ----------
    folder : Path
        Where they go; its parent must be there.
    resume : bool
        Whether the training that is there shall go on.

    Raises
    ------
    PoseFileError
        Where a file could not be written, where there is a training and ``resume`` was not asked for, or where there
        are weights or losses without the checkpoint that one could go on from.
    """
    if not folder.is_dir():
        if folder.exists() or not folder.parent.is_dir():
            why = "a file of that name is there" if folder.exists() else f"the folder {folder.parent} does not exist"
            raise PoseFileError(f"{folder}: can't be made ({why}).")
        check_writable(folder)
        return
    for name in (CHECKPOINT, WEIGHTS, LOSSES):
        check_writable(folder / name)
    there = [name for name in (CHECKPOINT, WEIGHTS, LOSSES) if (folder / name).exists()]
    if CHECKPOINT in there and not resume:
        raise PoseFileError(f"{folder}: holds a training already. Pass --resume to go on, or give another folder.")
    if there and CHECKPOINT not in there:
        raise PoseFileError(
            f"{folder}: holds {' and '.join(there)}, but no {CHECKPOINT} that --resume could go on from. "
            "Give another folder; model.start begins with weights that are there."
        )


def write_losses(folder: Path, epochs: Sequence[tuple[float, ...]]) -> None:
    """Write the loss curve whole or not at all.

    Parameters
    ----------
    folder : Path
        Where to.
    epochs : sequence of tuple
        Epoch, step, learning rate, training loss and validation loss (NaN: no validation) of each.

    Raises
    ------
    PoseFileError
        Where it can't be written.
    """
    lines = ["epoch,step,learning_rate,training_loss,validation_loss"]
    lines += [f"{e:.0f},{s:.0f},{rate:.6g},{train:.8g},{val:.8g}" for e, s, rate, train, val in epochs]
    text = "\n".join(lines) + "\n"
    write_file(folder / LOSSES, lambda file: file.write(text.encode()))


def digests(path: str | Path) -> dict[str, str]:
    """Tell data by a few letters for each array that a training reads.

    They are of the file's numbers as they are stored, so that they are the same on every machine.

    Parameters
    ----------
    path : str or Path
        Motion capture, or pairs of poses and keypoints.

    Returns
    -------
    dict of str to str
        By the array's name.

    Raises
    ------
    PoseFileError
        Where the file can't be read.
    """
    found = {}
    for name, array in read_npz(path).items():
        if name in _READ:
            digest = hashlib.blake2b(f"{array.dtype.str[1:]} {array.shape}".encode(), digest_size=8)
            digest.update(array.astype(array.dtype.newbyteorder("<")).tobytes())
            found[name] = digest.hexdigest()
    return found


def check_same(path: Path, before: Mapping[str, Any], config: Config, data: Mapping[str, str]) -> None:
    """Refuse to go on from the checkpoint of another training.

    Parameters
    ----------
    path : Path
        Of the checkpoint.
    before : mapping
        What it says of its training: ``config`` and the digests of its ``data``. Older checkpoints lack them and go on
        with any data.
    config : Config
        That of now; its number of epochs may be another one.
    data : mapping of str to str
        The digests of now; none where they are not known.

    Raises
    ------
    PoseDataError
        Where a setting or the data differ.
    """
    then, now, default = before["config"], config.table(), Config().table()
    names = [(table, name) for table in ("model", "data", "train") for name in now[table]]
    names.remove(("train", "epochs"))
    changed = [f"{t}.{n}" for t, n in names if _plain(then[t].get(n, default[t][n])) != _plain(now[t][n])]
    if changed:
        raise PoseDataError(
            f"{path}: of another configuration ({', '.join(changed)} differ). "
            "Give the configuration it was started with, or another folder."
        )
    known: Mapping[str, str] = before.get("data") or data
    if data and (other := sorted(name for name in {*known, *data} if known.get(name) != data.get(name))):
        raise PoseDataError(
            f"{path}: of other data ({', '.join(other)} differ). Give the data it was started with, or another folder."
        )


def _plain(value: Any) -> Any:
    """Turn tuples into lists, as JSON does."""
    if isinstance(value, dict):
        return {name: _plain(item) for name, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value
