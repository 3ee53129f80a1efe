"""The command line: thin; what a command needs is imported when it runs."""

import os

# Before numpy is imported, which reads it then. Threads of the linear algebra gain nothing on
# matrices of these sizes, waste processor time where other processes run, and
# disturb the tick.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
