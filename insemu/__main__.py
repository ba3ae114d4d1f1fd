"""``python -m insemu``."""

from insemu.cli import main

if __name__ == "__main__":  # processes of a cluster import this again
    main()
