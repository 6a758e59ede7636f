"""`python -m agents`, which is `gmapspring` where that is not on the path."""

import sys

from agents.command_line import main

if __name__ == "__main__":
    sys.exit(main())
