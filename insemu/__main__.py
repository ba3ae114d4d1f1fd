"""``python -m insemu``."""

from insemu.cli import main

main()
