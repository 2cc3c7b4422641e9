"""Makes the pictures of the page of figures, and the README's, by the commands that stand on the page.

Run as ``python docs/pictures.py``.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent


def main() -> None:
    """Run the page's commands in an empty folder, and copy the pictures that it shows."""
    text = (HERE / "figures.md").read_text(encoding="utf-8")
    target = HERE / "pictures/figures"
    target.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for command in ["posecal demo world", *re.findall(r"^\$ (.*)", text, re.MULTILINE)]:
            words = [sys.executable, "-m", *shlex.split(command)]
            subprocess.run(words, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        for name in re.findall(r"\(pictures/figures/([\w.-]+)\)", text):
            shutil.copy(Path(folder, name), target)
        shutil.copy(Path(folder, "world/samplers.svg"), HERE / "pictures")


if __name__ == "__main__":
    main()
