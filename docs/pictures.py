"""Makes the pictures that pages show, and the README's, by the commands and examples that stand on the pages.

Run as ``python docs/pictures.py``. PNG files, of other commands too, are reduced to a palette of 128 colours.
"""

from __future__ import annotations

import doctest
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

HERE = Path(__file__).parent
PAGES = ("figures", "calibration", "recalibrate", "joint-angles")


def make(page: str) -> None:
    """Run a page's commands and examples in this folder, and copy the pictures that it shows."""
    text = (HERE / f"{page}.md").read_text(encoding="utf-8")
    names: dict[str, object] = {}
    for kind, block in re.findall(r"```(console|python)\n(.*?)```", text, re.DOTALL):
        if kind == "python":
            exec("".join(example.source for example in doctest.DocTestParser().get_examples(block)), names)
        for command in re.findall(r"^\$ (.*)", block, re.MULTILINE) if kind == "console" else ():
            words = [sys.executable, "-m", *shlex.split(command)]
            subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    for target in re.findall(rf"\((pictures/{page}/[\w.-]+)\)", text):
        shutil.copy(Path(target).name, HERE / target)


def main() -> None:
    """Make the pictures of all pages in an empty folder."""
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        subprocess.run([sys.executable, "-m", "posecal", "demo", "world"], check=True, stdout=subprocess.DEVNULL)
        shutil.copy("world/calibrated.npz", "hyps.npz")
        for page in PAGES:
            make(page)
        shutil.copy("world/samplers.svg", HERE / "pictures")
        os.chdir(HERE)
    for path in HERE.glob("pictures/**/*.png"):
        with Image.open(path) as picture:
            if picture.mode != "P":
                picture.convert("RGB").quantize(128).save(path, optimize=True)


if __name__ == "__main__":
    main()
