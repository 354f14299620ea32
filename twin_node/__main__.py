"""`python -m twin_node`: the command, where its script is not on the path."""

import sys

from twin_node.cli import main

if __name__ == "__main__":
    sys.exit(main())
