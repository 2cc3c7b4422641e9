"""``python -m posecal`` is ``posecal``."""

from posecal.cli import main

main()
