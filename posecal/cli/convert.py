"""``posecal convert``: files of other tools into the file that posecal reads."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from posecal.cli import options as opt
from posecal.cli.running import check_outputs, say
from posecal.errors import for_command_line


def convert(
    files: Annotated[list[Path], opt.argument("Files: .csv .trc .c3d .json .mat .h5 .pt .pkl .npz .npy.")],
    output: opt.Output,
    *,
    like: Annotated[
        str | None,
        opt.reading(
            "The tool, where the file does not show it: wide, long, angles, deeplabcut, anipose, freemocap, mediapipe, "
            "openpose, panoptic, interhand or mmpose."
        ),
    ] = None,
    role: Annotated[Literal["truth", "hypotheses"] | None, opt.reading("What the poses are.")] = None,
    each_file: Annotated[
        Literal["frames", "hypothesis"] | None, opt.reading("What each of several files holds.", "--each-file")
    ] = None,
    dataset: Annotated[str | None, opt.reading("The array to read, of a file with several.")] = None,
    axes: Annotated[str | None, opt.reading("Layout of that array, such as MKD or M(KD).")] = None,
    unit: Annotated[str | None, opt.reading("mm, cm, m, px, …, where the file states none.")] = None,
    joints: Annotated[str | None, opt.reading("Names for joints without: h36m-17, ….", "--joint-names")] = None,
    fps: Annotated[float | None, opt.reading("Frames per second, where the file states none.")] = None,
    person: Annotated[str | None, opt.reading("One of several people of a .json file: an id, or 0, 1, ….")] = None,
) -> None:
    """Convert files of other tools into the .npz file that posecal reads, and say what was assumed."""
    check_outputs(*files, output=output)
    from posecal.conversion import convert as convert_files

    how = {"like": like, "role": role, "each_file": each_file, "dataset": dataset, "axes": axes, "unit": unit}
    more = {"joints": joints, "fps": fps, "person": person, "words": for_command_line}
    _, assumed = convert_files(files, output, **how, **more)  # type: ignore[arg-type]
    for line in assumed:
        say(f"assumed: {line}.")
    say(f"{output}: written.")
