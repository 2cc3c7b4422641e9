"""Tables of coordinates, written as other tools write them."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

Array = np.ndarray[Any, Any]
JOINTS = ["Hip", "RKnee", "LKnee", "Head"]
M, K = 6, 4


def wide(poses: Array, path: Path, form: str = "{joint}_{axis}") -> Path:
    names = [form.format(joint=joint, axis=axis) for joint in JOINTS for axis in "xyz"[: poses.shape[2]]]
    pd.DataFrame(poses.reshape(len(poses), -1), columns=names).to_csv(path, index_label="frame")
    return path


def long(poses: Array, path: Path, **more: Any) -> Path:
    rows = [
        {"frame": m, "joint": JOINTS[k], **dict(zip("xyz", poses[m, k], strict=True)), **more}
        for m in range(len(poses))
        for k in range(K)
    ]
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def trc(poses: Array, path: Path, unit: str = "mm") -> Path:
    head = [
        f"PathFileType\t4\t(X/Y/Z)\t{path.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"60.00\t60.00\t{len(poses)}\t{K}\t{unit}\t60.00\t1\t{len(poses)}",
        "Frame#\tTime\t" + "\t\t\t".join(JOINTS) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k}" for k in range(1, K + 1) for axis in "XYZ"),
        "",
    ]
    rows = ["\t".join([str(m + 1), f"{m / 60:.4f}", *(f"{v}" for v in poses[m].ravel())]) for m in range(len(poses))]
    path.write_text("\n".join([*head, *rows]) + "\n", encoding="utf-8")
    return path
