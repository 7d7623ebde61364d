"""The jobs: prepare a log, run both estimators, compare, solve, check, map."""
