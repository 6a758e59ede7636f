"""The command line: python -m agents train | evaluate | demo | study | report."""

import sys

from agents.command_line import main

if __name__ == "__main__":
    sys.exit(main())
