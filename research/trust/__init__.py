"""What a verdict is worth, measured: `python -m research.trust [--help]`."""
