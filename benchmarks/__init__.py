"""Measurements, each a script: `python -m benchmarks.NAME [--help]`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
