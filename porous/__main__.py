"""``python -m porous``: the command line."""

import sys

from porous.cli import main

if __name__ == "__main__":
    sys.exit(main())
