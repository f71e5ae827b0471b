"""``python -m handeye_fg``: the command line."""

import sys

from handeye_fg.supervised import main

if __name__ == "__main__":
    sys.exit(main())
