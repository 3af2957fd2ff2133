"""``python -m etendue``."""

from etendue.cli import main

if __name__ == "__main__":
    main(prog_name="etendue")
