"""For all tests."""

import os

# As the application does (scanner/__init__.py); with several test processes on two cores it matters even more.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
