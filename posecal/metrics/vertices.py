"""Per-vertex error: MPJPE under the name that the field has for it where the points are the vertices of a mesh."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from posecal.engine.metric import Metric
from posecal.engine.scope import Scope
from posecal.metrics.mpjpe import mpjpe_metrics


def vertex_metrics(scope: Scope) -> Iterator[Metric]:
    """PVE and PA-PVE, of meshes of a known number of vertices, and of any points where they are asked for."""
    for metric in mpjpe_metrics(scope):
        prefix = metric.name.removesuffix("mpjpe")
        if prefix in {"", "pa_"} and (scope.spec.is_mesh or f"{prefix}pve" in scope.protocol.wanted):
            yield replace(
                metric,
                name=f"{prefix}pve",
                label=metric.label.replace("MPJPE", "PVE"),
                brief=metric.brief.replace("joints", "vertices"),
                definition=metric.definition.replace("joints", "vertices"),
                headline=scope.spec.is_mesh,
                in_joint_table=False,
                reading="The field's name for the MPJPE of a mesh's vertices: the error of its surface.",
                source="Pavlakos et al., arXiv:1904.05866; Shin et al., arXiv:2312.07531 (PVE)",
            )
