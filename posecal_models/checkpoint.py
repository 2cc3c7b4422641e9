"""Weights and checkpoints as safetensors files, written atomically.

Nothing is unpickled. A weights file holds the tensors of an estimator, those of its standardizer included, and in its
header the estimator's description and notes on its training.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save
from torch import Tensor

import posecal
from posecal.conversion.containers import load_tensors
from posecal.data.write import write_file
from posecal.errors import PoseDataError, PoseFileError, did_you_mean, first_few, refuse_unreadable
from posecal_models.data.standardizer import Standardizer
from posecal_models.estimators.cgnf.flow import FlowSize
from posecal_models.estimators.cgnf.model import CGNF
from posecal_models.estimators.cgnf.released import from_released
from posecal_models.estimators.registry import ReferenceEstimator, build, describe

__all__ = [
    "convert_format_1",
    "load_estimator",
    "load_released",
    "named_weights",
    "notes_of",
    "read_tensors",
    "resolve_device",
    "save_estimator",
    "write_tensors",
]

_FOLDER = Path(__file__).parent / "weights"
_HEADER, _DIGEST = "posecal", "digest"

FORMAT = 2
"""Version of the files. 1, without a number in the file: the tensors of a cGNF's blocks were stacked."""


def named_weights() -> tuple[str, ...]:
    """Name the weights that come with the package."""
    return tuple(sorted(path.stem for path in _FOLDER.glob("*.safetensors")))


def resolve_device(name: str) -> torch.device:
    """Find a PyTorch device by name.

    Parameters
    ----------
    name : str
        ``cpu``, ``cuda``, ``cuda:1``, ``xpu``, ``mps``, or ``auto`` for the GPU if there is one.

    Returns
    -------
    torch.device
        The device.

    Raises
    ------
    PoseDataError
        Where the name is unknown or there is no such device.
    """
    available = {
        "cpu": True,
        "cuda": torch.cuda.is_available(),
        "xpu": torch.xpu.is_available(),
        "mps": torch.backends.mps.is_available(),
    }
    if name == "auto":
        return torch.device([kind for kind, is_there in available.items() if is_there][-1])
    try:
        device = torch.device(name)
    except RuntimeError as problem:
        raise PoseDataError(f"device: {name!r} is not known; expected {', '.join(available)} or auto.") from problem
    if device.type not in available:
        raise PoseDataError(f"device: {name!r}; expected {', '.join(available)} or auto.")
    if not available[device.type]:
        raise PoseDataError(f"device: {name}, but PyTorch {torch.__version__} sees no such GPU; expected cpu or auto.")
    return device


def write_tensors(path: str | Path, tensors: Mapping[str, Tensor], about: dict[str, Any]) -> None:
    """Write a safetensors file atomically; the same tensors and values give the same bytes.

    Parameters
    ----------
    path : str or Path
        Output file.
    tensors : mapping of str to Tensor
        Tensors by name.
    about : dict
        Plain values for the header.

    Raises
    ------
    PoseFileError
        Where it can't be written: no such folder, no permission, no space left.
    """
    on_cpu = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    about = {"format": FORMAT, **about}
    text = json.dumps({**about, _DIGEST: _digest(on_cpu, json.dumps(about))})
    content = save(on_cpu, metadata={_HEADER: text})  # one entry: safetensors writes several in any order
    write_file(path, lambda file: file.write(content))


def read_tensors(path: str | Path, *, device: torch.device | str = "cpu") -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a file of :func:`write_tensors`.

    Parameters
    ----------
    path : str or Path
        The file.
    device : torch.device or str
        Device of the tensors.

    Returns
    -------
    tensors : dict of str to Tensor
        Tensors by name.
    about : dict
        The header's values.

    Raises
    ------
    PoseFileError
        Where the file is missing, damaged, of another format, or was not written by :func:`write_tensors`.
    """
    tensors, about = _read(path)
    if (found := about.pop("format", 1)) != FORMAT:
        raise PoseFileError(
            f"{path}: of format {found}; expected {FORMAT}. "
            + (
                "Convert weights with posecal-models convert, and start a training anew."
                if found == 1
                else "Use the version of posecal that wrote it."
            )
        )
    return {name: tensor.to(device) for name, tensor in tensors.items()}, about


def _read(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read tensors and header of any format, and compare the digest."""
    if not Path(path).is_file():
        raise PoseFileError(f"{path}: is not there; expected a .safetensors file.")
    with refuse_unreadable(path, "damaged or no safetensors file ({}). Copy it again."):
        with safe_open(str(path), framework="pt") as file:
            header = file.metadata() or {}
            if _HEADER not in header:
                raise PoseFileError(
                    f"{path}: a safetensors file without the header of posecal; expected one written by posecal-models."
                )
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        about: dict[str, Any] = dict(json.loads(header[_HEADER]))
        digest = about.pop(_DIGEST, None)
        if digest != _digest(tensors, json.dumps(about)):
            raise PoseFileError(f"{path}: damaged: its numbers differ from those that were written. Copy it again.")
    return tensors, about


def _digest(tensors: Mapping[str, Tensor], about: str) -> str:
    """Compute the SHA-256 of the header and of all tensors with their names, types and shapes."""
    sha256 = hashlib.sha256(about.encode())
    for name in sorted(tensors):
        tensor = tensors[name]
        sha256.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}\n".encode())
        sha256.update(tensor.reshape(-1).view(torch.uint8).numpy().data)
    return sha256.hexdigest()


def save_estimator(
    path: str | Path,
    estimator: ReferenceEstimator,
    *,
    tensors: Mapping[str, Tensor] | None = None,
    notes: dict[str, Any] | None = None,
    half: bool = False,
) -> None:
    """Write the weights of an estimator.

    Parameters
    ----------
    path : str or Path
        Output file, ``*.safetensors``.
    estimator : ReferenceEstimator
        The estimator to save.
    tensors : mapping of str to Tensor, optional
        Other weights of the same estimator; its own where not given.
    notes : dict, optional
        Plain values on its training.
    half : bool
        Whether parameters that are matrices are written in half precision.

    Raises
    ------
    PoseFileError
        Where it can't be written.
    """
    about = {"version": posecal.__version__, "estimator": describe(estimator), "notes": notes or {}}
    tensors = dict(estimator.state_dict() if tensors is None else tensors)
    if half:
        matrices = {name for name, parameter in estimator.named_parameters() if parameter.ndim > 1}
        tensors = {name: tensor.half() if name in matrices else tensor for name, tensor in tensors.items()}
    write_tensors(path, tensors, about)


def load_estimator(name: str | Path, *, device: torch.device | str = "cpu") -> ReferenceEstimator:
    """Load an estimator with its weights.

    Parameters
    ----------
    name : str or Path
        One of :func:`named_weights`, or a file of :func:`save_estimator`.
    device : torch.device or str
        Device of the weights.

    Returns
    -------
    ReferenceEstimator
        In evaluation mode.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file is missing or damaged, or its tensors don't fit its description.
    """
    tensors, about = read_tensors(_path_of(name), device=device)
    if "estimator" not in about:
        raise PoseFileError(
            f"{name}: holds the state of a training; expected weights. Give weights.safetensors of the same folder."
        )
    _check_size(about["estimator"], tensors, str(name))
    estimator = build(about["estimator"])
    _load_state(estimator, tensors, str(name))
    return estimator.to(device).eval()


def notes_of(name: str | Path) -> dict[str, Any]:
    """Read the notes on its training from a weights file.

    Parameters
    ----------
    name : str or Path
        As for :func:`load_estimator`.

    Returns
    -------
    dict
        Plain values.
    """
    _, about = read_tensors(_path_of(name))
    notes: dict[str, Any] = about.get("notes", {})
    return notes


def _path_of(name: str | Path) -> Path:
    path = _FOLDER / f"{name}.safetensors" if str(name) in named_weights() else Path(name)
    if not path.is_file():
        raise PoseFileError(f"{name}: no such weights. {did_you_mean(str(name), named_weights())}".strip())
    return path


def convert_format_1(path: str | Path, output: str | Path) -> None:
    """Convert a weights file of format 1, whose tensors of a cGNF's blocks were stacked: the same numbers.

    Parameters
    ----------
    path, output : str or Path
        The file, and that to write.

    Raises
    ------
    PoseFileError, PoseDataError
        Where it can't be read or written, is damaged, or holds no weights of format 1.
    """
    stacked, about = _read(path)
    if "format" in about or "estimator" not in about:
        raise PoseDataError(f"{path}: holds no weights of format 1; there is nothing to convert.")
    tensors: dict[str, Tensor] = {}
    for name, tensor in stacked.items():
        before, coupling, parameter = name.rpartition("couplings.")
        if coupling:
            parameter = parameter.removeprefix("actnorm_")
            tensors |= {f"{before}blocks.{block}.{parameter}": part for block, part in enumerate(tensor)}
        else:
            tensors[name] = tensor
    write_tensors(output, tensors, about)


def load_released(path: str | Path, *, blocks: int | None = None) -> tuple[CGNF, dict[str, Tensor]]:
    """Read a published cGNF checkpoint, the ``state_dict`` of propose 0.2.0.

    Parameters
    ----------
    path : str or Path
        The file; it is read with ``weights_only=True``, so that it can't run code.
    blocks : int, optional
        Expected number of blocks; any where not given.

    Returns
    -------
    estimator : CGNF
        With the ``released`` options and that code's constants as standardizer, in evaluation mode.
    unused : dict of str to Tensor
        Parameters of the file that no output depends on.

    Raises
    ------
    PoseFileError, PoseDataError
        Where the file can't be read, or is not such a checkpoint.
    """
    state = load_tensors(Path(path))
    if not isinstance(state, dict) or not all(isinstance(tensor, Tensor) for tensor in state.values()):
        raise PoseDataError(f"{path}: holds no state_dict; expected tensors by name.")
    with refuse_unreadable(path, "lacks {}; expected the complete state_dict of a cGNF."):
        used, unused = from_released(state)
        hidden, context = used["blocks.0.first.from_context.weight"].shape
        size = FlowSize(
            blocks=sum(name.endswith(".log_scale") for name in used),
            hidden=hidden,
            context=context,
            embedding=used["embedding.first_own.bias"].shape[0],
        )
    if blocks is not None and size.blocks != blocks:
        raise PoseDataError(f"{path}: {size.blocks} blocks; expected {blocks}.")
    estimator = CGNF(size, scale="sigmoid", backward_weights=False)
    _load_state(estimator.flow, used, str(path))
    estimator.standardizer = Standardizer.released(len(estimator.joints))
    return estimator.eval(), unused


def _check_size(description: Any, tensors: Mapping[str, Tensor], which: str) -> None:
    """Refuse a description of numbers that no tensor of the file has, before an estimator of that size is built."""
    most = max(len(tensors), *(length for tensor in tensors.values() for length in tensor.shape))
    members = description.values() if isinstance(description, Mapping) else description
    for value in members:
        if isinstance(value, int) and value > most:
            raise PoseDataError(
                f"{which}: weights don't fit the estimator: a size of {value:,}; expected at most {most:,}."
            )
        if isinstance(value, Mapping):
            _check_size(value, tensors, which)


def _load_state(module: torch.nn.Module, tensors: Mapping[str, Tensor], which: str) -> None:
    """Load tensors into a module, or raise an error that lists all that don't fit."""
    expected = module.state_dict()
    tensors = {name: tensor.float() if tensor.dtype == torch.float16 else tensor for name, tensor in tensors.items()}
    mismatched = [f"{name} {tuple(tensors[name].shape)}, expected {tuple(expected[name].shape)}"
                  for name in expected if name in tensors and tensors[name].shape != expected[name].shape]  # fmt: skip
    mismatched += [f"{name} {tensors[name].dtype}, expected {expected[name].dtype}"
                   for name in expected if name in tensors and tensors[name].dtype != expected[name].dtype]  # fmt: skip
    missing = [name for name in expected if name not in tensors]
    unexpected = [name for name in tensors if name not in expected]
    if mismatched or missing or unexpected:
        parts = [
            f"{len(mismatched)} tensors of another size or type ({first_few(mismatched, 1)})" if mismatched else "",
            f"{len(missing)} missing ({first_few(missing)})" if missing else "",
            f"{len(unexpected)} too many ({first_few(unexpected)})" if unexpected else "",
        ]
        raise PoseDataError(f"{which}: weights don't fit the estimator: {'; '.join(p for p in parts if p)}.")
    module.load_state_dict(dict(tensors))
