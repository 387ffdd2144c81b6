"""These tests are for `make test-compose` alone, which starts the container engine they need and builds the image."""

import os

collect_ignore_glob = [] if "SWEEPID_CELL_TEST" in os.environ else ["test_*.py"]
