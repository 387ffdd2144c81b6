"""Whether this computer can set PDF."""

import os
from ctypes.util import find_library

import pytest

WITHOUT_PANGO = pytest.mark.skipif(
    find_library("pangoft2-1.0") is None and "CI" not in os.environ, reason="no Pango on this computer; CI has one"
)
