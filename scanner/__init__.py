"""The application: patterns, capture, decoding, reconstruction, report and the command line."""

import os

# The matrices here are small and many: handing each to a pool of threads costs several times what it gains. What is
# worth several cores is cut into pieces where it is computed. This has to be said before NumPy is loaded.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
