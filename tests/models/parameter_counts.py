"""Parameters of the published model sizes: used, without gradient, and unused; those of docs/models-results.md."""

from __future__ import annotations

from typing import NamedTuple

from posecal_models.estimators.cgnf.flow import FlowSize

__all__ = ["PUBLISHED", "ParameterTable", "parameter_table"]

PUBLISHED = {"small": 852_546, "large": 3_301_546, "xlarge": 8_318_741}
"""Trainable parameters as the paper counts them."""


class ParameterTable(NamedTuple):
    """The published parameter count, by use.

    Attributes
    ----------
    used : int
        Parameters that the density depends on.
    times_zero : int
        Weights that multiply the root's features, which are always 0: their gradient is 0.
    backward : int
        The map of messages from child to parent, which the released code never uses.
    last_updates : int
        The second layer's maps of context and root, whose output is never read.
    """

    used: int
    times_zero: int
    backward: int
    last_updates: int

    @property
    def published(self) -> int:
        """Their sum, the paper's number."""
        return sum(self)


def parameter_table(
    size: FlowSize, *, dimensions: int = 3, nodes: int = 16, keypoint_features: int = 2
) -> ParameterTable:
    """Count the parameters of the released code by use.

    Parameters
    ----------
    size : FlowSize
        L, H, C and E.
    dimensions, nodes, keypoint_features : int
        D, K and the coordinates of a keypoint.

    Returns
    -------
    ParameterTable
        The parts of the published number.

    Notes
    -----
    Differs from the published code: its state dict of version 0.2.0 holds two more attention maps a layer, which are
    unused too and which the published numbers don't count.

    Examples
    --------
    >>> from posecal_models.estimators.cgnf.flow import SIZES
    >>> parameter_table(SIZES["small"]).published
    852546
    """
    blocks, hidden, context, embedding = size.blocks, size.hidden, size.context, size.embedding
    coordinates = dimensions - 1

    def map_of(features: int, features_out: int) -> int:
        return features * features_out + features_out

    first = 3 * map_of(coordinates, hidden) + 2 * map_of(context, hidden) + 2 * map_of(dimensions, hidden)
    second = 7 * map_of(hidden, hidden)
    updates = map_of(hidden, hidden) + map_of(hidden, 2)
    embedded = nodes**2 + 2 * keypoint_features * embedding + embedding + 2 * embedding * context + context
    total = blocks * (first + second + updates + 2 * dimensions) + embedded

    times_zero = blocks * 2 * dimensions * hidden
    backward = blocks * (map_of(coordinates, hidden) + map_of(hidden, hidden))
    last_updates = blocks * 2 * map_of(hidden, hidden)
    return ParameterTable(total - times_zero - backward - last_updates, times_zero, backward, last_updates)
