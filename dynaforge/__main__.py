"""`python -m dynaforge`: the `dynaforge` command."""

import sys

from dynaforge.cli.main import main

sys.exit(main())
