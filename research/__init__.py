"""Measurements and studies, not installed: `python -m research.NAME [--help]`."""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy is imported
