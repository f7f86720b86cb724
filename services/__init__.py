"""The server's processes, each started as ``python -m services.<name>``.

Numbers run on one thread a process: more cores are used by more processes. Numerical libraries
read these variables when they are loaded, so they are set before anything else is imported.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
