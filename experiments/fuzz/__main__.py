"""`python -m experiments.fuzz --count 100000`."""

import sys

from experiments.fuzz.run import main

sys.exit(main())
