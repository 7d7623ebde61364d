"""The layers of a dense map: one contract, several ways to keep what a scanner saw."""
