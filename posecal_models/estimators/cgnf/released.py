"""Conversion of published cGNF checkpoints: tensor names of propose 0.2.0 and their counterparts here.

Only the names are used; no code of that project is in posecal.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from torch import Tensor

from posecal.errors import PoseDataError, first_few

__all__ = ["from_released"]

_LAYER = {
    "layers.x": "from_self",
    "layers.x->x": "from_parent",
    "layers.c->x": "from_context",
    "layers.r->x": "from_root",
    "layers.c": "next_context",
    "layers.r": "next_root",
    "pool": "pool",
}
_EMBEDDING = {
    "adj": "adjacency",
    "layers.0.lin_rel.weight": "first_neighbours.weight",
    "layers.0.lin_root.weight": "first_own.weight",
    "layers.0.lin_root.bias": "first_own.bias",
    "layers.1.lin_rel.weight": "second_neighbours.weight",
    "layers.1.lin_root.weight": "second_own.weight",
    "layers.1.lin_root.bias": "second_own.bias",
}
_BUFFER = re.compile(r"(initialized|identity_features|transform_features)$")
_NET = re.compile(r"_transform\._transforms\.(\d+)\.transform_net\.layers\.([01])\.(.+)\.(weight|bias)$")
_ACTNORM = re.compile(r"_transform\._transforms\.(\d+)\.(log_scale|shift)$")


def from_released(state: Mapping[str, Tensor]) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Convert a published state dict, and list its unused parameters.

    Parameters
    ----------
    state : mapping of str to Tensor
        The ``state_dict`` of a released checkpoint, read with ``weights_only=True``.

    Returns
    -------
    used : dict of str to Tensor
        Tensors by the names of :class:`posecal_models.estimators.cgnf.flow.GraphFlow` with the ``released`` options.
    unused : dict of str to Tensor
        Parameters that no output depends on, by their published names.

    Raises
    ------
    PoseDataError
        Where a name is not one of a cGNF.

    Notes
    -----
    Differs from the published code: unused are the map of messages from child to parent, the second layer's maps of
    context and root, and the attention of both layers.

    Examples
    --------
    >>> import torch
    >>> used, unused = from_released({"_embedding_net.adj": torch.ones(2, 2), "_extra.attention.bias": torch.ones(1)})
    Traceback (most recent call last):
    posecal.errors.PoseDataError: checkpoint: 1 tensor is not part of a cGNF (_extra.attention.bias)...
    """
    used: dict[str, Tensor] = {}
    unused: dict[str, Tensor] = {}
    unknown: list[str] = []
    for name, tensor in state.items():
        if _BUFFER.search(name):
            continue
        if match := _ACTNORM.match(name):
            used[f"blocks.{int(match[1]) // 2}.{match[2]}"] = tensor
        elif match := _NET.match(name):
            layer = int(match[2])
            map_name = _LAYER.get(match[3])
            if map_name is None or (layer == 1 and map_name.startswith("next_")):
                unused[name] = tensor
            else:
                used[f"blocks.{int(match[1]) // 2}.{('first', 'second')[layer]}.{map_name}.{match[4]}"] = tensor
        elif name.startswith("_embedding_net.") and (parameter := _EMBEDDING.get(name.split(".", 1)[1])):
            used[f"embedding.{parameter}"] = tensor
        else:
            unknown.append(name)
    if unknown:
        raise PoseDataError(
            f"checkpoint: {len(unknown)} tensor{'s are' if len(unknown) > 1 else ' is'} not part of a cGNF "
            f"({first_few(unknown)}); expected the state_dict of propose 0.2.0's cGNF."
        )
    return used, unused
