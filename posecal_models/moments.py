"""Moments of Adam as named tensors, for checkpoints."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor, nn
from torch.optim import Optimizer

__all__ = ["load_moments", "moments"]

_NAMES = "step", "exp_avg", "exp_avg_sq"


def moments(optimizer: Optimizer, parameters: Mapping[str, nn.Parameter]) -> dict[str, Tensor]:
    """Return the moments of parameters that had a step.

    Parameters
    ----------
    optimizer : Optimizer
        Adam, AdamW or another with the same moments.
    parameters : mapping of str to Parameter
        Its parameters by name.

    Returns
    -------
    dict of str to Tensor
        By ``adam.``, the moment's name and the parameter's.
    """
    return {
        f"adam.{moment}.{name}": optimizer.state[parameter][moment]
        for name, parameter in parameters.items()
        if optimizer.state.get(parameter)
        for moment in _NAMES
    }


def load_moments(optimizer: Optimizer, parameters: Mapping[str, nn.Parameter], tensors: Mapping[str, Tensor]) -> None:
    """Load what :func:`moments` returned.

    Parameters
    ----------
    optimizer : Optimizer
        Before its first step.
    parameters : mapping of str to Parameter
        Its parameters by name.
    tensors : mapping of str to Tensor
        The moments, among others; on the parameters' device.

    Raises
    ------
    KeyError
        Where one of a parameter's moments is missing.
    """
    for name, parameter in parameters.items():
        if f"adam.{_NAMES[0]}.{name}" in tensors:
            optimizer.state[parameter] = {moment: tensors[f"adam.{moment}.{name}"] for moment in _NAMES}
