"""`python -m robomill` is the command `robomill`."""

import sys

from robomill.cli import main

sys.exit(main())
